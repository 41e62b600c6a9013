"""Reading an MCAP file strictly: front to back, bounded, every checksum checked, losses reported.

The data section is the truth; the index and the summary at the end of the file are only compared with it.
What cannot be trusted is left out and named:

* a chunk that fails any check is dropped whole;
* messages outside chunks of a log that has chunks count only if the checksum of the data section holds: one
  flipped bit turns a Message Index into a Message;
* in a log without chunks, messages count unless that checksum is wrong, or the file has its last bytes but the
  end of the data was not found: then the damage lies in the middle;
* a Schema or Channel that is redefined otherwise is an error: either meaning could be the true one.
"""

import os
from collections.abc import Callable
from pathlib import Path

from replay.base.errors import LogError
from replay.logs.container import records as r
from replay.logs.container.collect import Collector
from replay.logs.container.compression import BadChunk, unpack_chunk
from replay.logs.container.log import Channel, Findings, Log, ReadLimits
from replay.logs.container.log_bytes import Cut, Source
from replay.logs.container.records import Malformed, Opcode, RecordStream
from replay.logs.container.summary_section import SummarySection, read_attachment

_HELD = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.DATA_END}


def scan(path: str | os.PathLike[str], wanted: Callable[[Channel], bool], limits: ReadLimits | None = None) -> Log:
    """Read a whole log and keep the messages of wanted channels.

    Raises:
        LogError: the file is not a regular file, not MCAP, empty, or cut off before its first message;
            a schema or channel is redefined; too many channels; more wanted payload than the limit.
    """
    with Source(Path(path)) as source:
        return _Scan(source, wanted, limits or ReadLimits()).run()


class _Scan:
    """The state of one reading; used once."""

    def __init__(self, source: Source, wanted: Callable[[Channel], bool], limits: ReadLimits) -> None:
        self.source = source
        self.limits = limits
        self.findings = Findings()
        self.collected = Collector(source.path, wanted, limits, self.findings)
        self.summary = SummarySection()
        self.header: tuple[str, str] | None = None
        self.unpacked_bytes = 0
        self.data_ended = self.cut = False
        self.data_crc_holds: bool | None = None  # None: the file does not say

    def run(self) -> Log:
        """Read the file from end to end."""
        source, collected = self.source, self.collected
        source.check_magic()
        try:
            self._data_section()
            if self.data_ended:
                self._summary_section()
        except Cut:
            self._found_cut()
        sha256 = source.finish()
        in_the_middle = not self.data_ended and self._has_last_bytes()
        collected.settle(verified=self.data_crc_holds, doubtful=bool(self.summary.chunks) or in_the_middle)
        if self.cut and not collected.counts:
            raise LogError("E_TRUNCATED", source.path, "the file is cut off before its first complete message")
        self._compare_with_summary()
        profile, library = self.header or ("", "")
        return Log(
            path=source.path,
            sha256=sha256,
            size=source.size,
            profile=profile,
            library=library,
            channels=collected.table.channels,
            counts=dict(collected.counts),
            messages=tuple(sorted(collected.messages, key=lambda message: message.log_time)),
            metadata=tuple(collected.metadata),
            findings=self.findings.all(),
        )

    def _found_cut(self) -> None:
        self.cut = True
        where = "in its summary" if self.data_ended else "in the data; later messages are lost"
        text = f"the file is cut off at byte {self.source.size}, {where}"
        self.findings.add("W_TRUNCATED", text, lost=not self.data_ended)

    def _has_last_bytes(self) -> bool:
        """True if the file ends as a complete one does."""
        return self.source.tail(len(r.MAGIC)) == r.MAGIC

    # ---- the data section

    def _data_section(self) -> None:
        while not self.data_ended:
            at, crc = self.source.position, self.source.crc
            self.collected.num_records += 1
            if self.collected.num_records > self.limits.records:
                self.findings.add("W_TOTAL_TOO_LARGE", "more records than the limit; the rest is not read", lost=True)
                return
            opcode, length = r.RECORD_PREFIX.unpack(self.source.read(r.RECORD_PREFIX.size))
            stop = self._why_to_stop(opcode, length)
            if stop:
                text = f"{stop} (at byte {at}); the rest of the file is lost"
                self.findings.add("W_CORRUPT_RECORD", text, lost=True)
                return
            if opcode == Opcode.FOOTER:
                self.findings.add("W_EARLY_FOOTER", f"a Footer at byte {at} before the data's end", lost=True)
                return
            self._record(opcode, length, at, crc)

    def _why_to_stop(self, opcode: int, length: int) -> str:
        """Reason why there is no next record to read, or an empty text. Raises Cut where the file just ends."""
        if opcode == 0 and length == 0:
            return "zeros where a record should begin"
        if length <= self.source.left:
            return ""
        if length <= self.limits.record and not self._has_last_bytes():
            raise Cut
        return f"a {r.record_name(opcode)} record claims {length} bytes, {self.source.left} are left"

    def _record(self, opcode: int, length: int, at: int, crc: int) -> None:
        name = r.record_name(opcode)
        try:
            if opcode == Opcode.ATTACHMENT:
                self._attachment(length, at)
            elif opcode not in _HELD:
                self.source.skip(length)
                if opcode == 0:
                    self.findings.add("W_CORRUPT_RECORD", f"a record with opcode 0 at byte {at}")
            elif length > self.limits.record:
                self.source.skip(length)
                text = f"{name} of {length} bytes at byte {at} is skipped"
                self.findings.add("W_RECORD_TOO_LARGE", text, lost=True)
            else:
                self._held_record(opcode, self.source.read(length), at, crc)
        except Malformed as error:
            lost = opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.METADATA)
            self.findings.add("W_CORRUPT_RECORD", f"{name} at byte {at} is skipped: {error}", lost=lost)

    def _held_record(self, opcode: int, body: bytes, at: int, crc: int) -> None:
        if opcode == Opcode.CHUNK:
            self._chunk(body, at)
        elif opcode == Opcode.DATA_END:
            self._data_end(body, crc)
        elif opcode == Opcode.HEADER:
            self._header(body)
        else:
            self.collected.add(opcode, RecordStream(body))

    def _attachment(self, length: int, at: int) -> None:
        attachment = read_attachment(self.source, length)
        self.summary.attachments.append(at)
        if not attachment.sound:
            self.findings.add("W_CRC_ATTACHMENT", f"the checksum of attachment {attachment.name[:60]!r} is wrong")
        if attachment.odd_name:
            text = f"odd attachment name {attachment.name[:60]!r}; attachments are not unpacked"
            self.findings.add("W_ATTACHMENT_NAME", text)

    def _chunk(self, body: bytes, at: int) -> None:
        number = len(self.summary.chunks)
        start = end = None
        try:
            left = self.limits.total - self.unpacked_bytes
            data, *times = unpack_chunk(body, self.limits.chunk, left)
            self.unpacked_bytes += len(data)
            self.collected.add_chunk(data, number)
            start, end = times
        except (BadChunk, Malformed) as error:
            code = error.code if isinstance(error, BadChunk) else "W_CORRUPT_RECORD"
            self.findings.add(code, f"chunk {number} at byte {at} is dropped: {error}", lost=True)
        self.summary.chunks.append((at, start, end))

    def _data_end(self, body: bytes, crc: int) -> None:
        stated = r.parsed(r.kinds.DataEnd, RecordStream(body)).data_section_crc
        self.data_ended = True
        if stated:
            self.data_crc_holds = stated == crc
            if not self.data_crc_holds:
                self.findings.add("W_CRC_DATA", "the checksum of the data section is wrong")

    def _header(self, body: bytes) -> None:
        if self.header is not None:
            self.findings.add("W_DUPLICATE_HEADER", "a second Header; the first one counts")
            return
        if self.collected.num_records > 1:
            self.findings.add("W_NO_HEADER", "the Header is not the first record")
        header = r.parsed(r.kinds.Header, RecordStream(body))
        self.header = header.profile, header.library

    # ---- the summary section

    def _summary_section(self) -> None:
        self.summary.start = self.source.position
        self.source.crc = 0
        while True:
            at = self.source.position
            opcode, length = r.RECORD_PREFIX.unpack(self.source.read(r.RECORD_PREFIX.size))
            if length > min(self.source.left, self.limits.record):
                if not self._has_last_bytes():
                    raise Cut
                self.findings.add("W_INDEX", f"the summary is damaged at byte {at}; it is not needed")
                return
            crc, body = self.source.crc, self.source.read(length)
            if opcode == Opcode.FOOTER:
                self._footer(body, crc)
                return
            try:
                self.summary.add(opcode, RecordStream(body))
            except Malformed as error:
                text = f"{r.record_name(opcode)} in the summary: {error}"
                self.findings.add("W_INDEX", text, lost=opcode in (Opcode.CHUNK, Opcode.MESSAGE))

    def _footer(self, body: bytes, crc: int) -> None:
        try:
            for code, text in self.summary.check_footer(body, crc):
                self.findings.add(code, text)
        except Malformed as error:
            self.findings.add("W_CORRUPT_RECORD", f"the Footer is damaged: {error}")
        if self.source.read(min(self.source.left, len(r.MAGIC))) != r.MAGIC:
            raise Cut
        if self.source.left:
            text = f"{self.source.left} bytes after the end of the log are not used"
            another = self.source.read(min(self.source.left, len(r.MAGIC))) == r.MAGIC
            self.findings.add("W_TRAILING_BYTES", text + (": another log follows" if another else ""), lost=another)

    def _compare_with_summary(self) -> None:
        if self.header is None:
            self.findings.add("W_NO_HEADER", "the log has no Header")
        if self.data_ended and not self.cut:
            num_messages = sum(self.collected.counts.values())
            for code, text in self.summary.contradictions(self.collected.table, num_messages):
                self.findings.add(code, text)
