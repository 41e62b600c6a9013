"""The fields of message types that a log defines in IDL (`ros2idl`), in the subset that ROS 2 uses.

Modules, structs, typedefs of arrays; constants, annotations, comments and preprocessor lines are passed over. The text
is untrusted: one pass over its tokens, nothing recurses, and what is not understood is an error.
"""

import re
from typing import Final, NoReturn

from replay.logs.messages.types import DefinitionError

MAX_TYPES: Final = 256
MAX_FIELDS: Final = 512
"""Most fields of one type."""
MAX_DEPTH: Final = 16
"""Most modules within each other."""

MessageDefinition = dict[str, list[tuple[str, str]]]
"""Type and name of each field, by type. Types of packages are written `pkg/Type`."""


_TOKEN = re.compile(
    r"""\s+ | //[^\n]* | /\*.*?\*/ | \#[^\n]* | ={3,}[^\n]* | IDL:[^\n]*  # passed over
    | (?P<token> "(?:[^"\\]|\\.)*" | [A-Za-z_][A-Za-z0-9_]* | :: | . )""",
    re.VERBOSE | re.DOTALL,
)
_PRIMITIVES = {
    "boolean": "bool",
    "octet": "uint8",
    "char": "uint8",
    "float": "float32",
    "double": "float64",
    "short": "int16",
    "long": "int32",
    "long long": "int64",
    "unsigned short": "uint16",
    "unsigned long": "uint32",
    "unsigned long long": "uint64",
    "string": "string",
    "wstring": "wstring",
} | {f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
_SEVERAL_WORDS = ("unsigned", "long", "short")


def parse_idl(text: str) -> MessageDefinition:
    """Fields of each type in an IDL text.

    Raises:
        DefinitionError: over a limit, or anything that is not in the subset.
    """
    tokens: list[str] = []
    for match in _TOKEN.finditer(text):
        token = match["token"]
        if token == '"' or (text.startswith("/*", match.start()) and token):  # or each would be searched to the end
            raise DefinitionError(f"{match[0]!r} opens what is never closed")
        if token:
            tokens.append(token)
    return _Parser(tokens).parse()


class _Parser:
    """Goes through the tokens once."""

    def __init__(self, tokens: list[str]) -> None:
        self.tokens = tokens
        self.pos = 0
        self.modules: list[str] = []
        self.layout: MessageDefinition = {}
        self.arrays: dict[str, str] = {}
        """Types that are named by typedefs, in full."""

    def parse(self) -> MessageDefinition:
        while self.pos < len(self.tokens):
            word = self._next()
            if word == "@":
                self._annotation()
            elif word == "module":
                self.modules.append(self._name())
                self._expect("{")
                if len(self.modules) > MAX_DEPTH:
                    raise DefinitionError(f"more than {MAX_DEPTH} modules within each other")
            elif word == "}" and self.modules:
                self.modules.pop()
                self._optional(";")
            elif word == "struct":
                self._struct()
            elif word == "typedef":
                self._typedef()
            elif word == "const":
                self._skip_to(";")
            else:
                self._refuse(word, "a module, struct, typedef or constant")
        if self.modules:
            raise DefinitionError(f"module {self.modules[-1][:40]!r} is not closed")
        return self.layout

    # ---- tokens

    def _next(self) -> str:
        if self.pos >= len(self.tokens):
            raise DefinitionError("the definition ends in the middle of a declaration")
        self.pos += 1
        return self.tokens[self.pos - 1]

    def _refuse(self, found: str, expected: str) -> NoReturn:
        raise DefinitionError(f"{found[:40]!r} where {expected} was expected")

    def _expect(self, word: str) -> None:
        found = self._next()
        if found != word:
            self._refuse(found, repr(word))

    def _optional(self, word: str) -> bool:
        found = self.pos < len(self.tokens) and self.tokens[self.pos] == word
        self.pos += found
        return found

    def _name(self) -> str:
        found = self._next()
        if not found.isidentifier():
            self._refuse(found, "a name")
        return found

    def _skip_to(self, end: str) -> None:
        while self._next() != end:
            pass

    def _annotation(self) -> None:
        self._name()
        if self._optional("("):
            depth = 1
            while depth:
                depth += {"(": 1, ")": -1}.get(self._next(), 0)

    # ---- declarations

    def _here(self, name: str) -> str:
        """A name in the modules that are open, as `pkg/Type`."""
        return "/".join([part for part in self.modules if part != "msg"] + [name])

    def _struct(self) -> None:
        fields = self.layout.setdefault(self._here(self._name()), [])
        if len(self.layout) > MAX_TYPES:
            raise DefinitionError(f"more than {MAX_TYPES} types")
        if fields:
            raise DefinitionError("a struct is defined twice")
        self._expect("{")
        while not self._optional("}"):
            if self._optional("@"):
                self._annotation()
                continue
            kind, name, size = self._declaration()
            fields.append((self.arrays.get(kind, kind) + size, name))
            if len(fields) > MAX_FIELDS:
                raise DefinitionError(f"more than {MAX_FIELDS} fields in a struct")
        self._expect(";")

    def _typedef(self) -> None:
        kind, name, size = self._declaration()
        self.arrays[self._here(name)] = kind + size
        if len(self.arrays) > MAX_FIELDS:
            raise DefinitionError(f"more than {MAX_FIELDS} typedefs")

    def _declaration(self) -> tuple[str, str, str]:
        """Type, name and size in brackets of one field, with its closing semicolon."""
        kind, name, size = self._type(), self._name(), ""
        if self._optional("["):
            size = f"[{self._number('a size')}]"
            self._expect("]")
        self._expect(";")
        return kind, name, size

    def _number(self, what: str) -> str:
        digits = ""
        while self.pos < len(self.tokens) and self.tokens[self.pos].isdigit() and len(digits) < 10:
            digits += self._next()
        if not digits:
            self._refuse(self._next(), what)
        return digits

    def _type(self) -> str:
        word = self._name()
        if word == "sequence":
            self._expect("<")
            element = self._named_type(self._name())
            bound = "<=" + self._number("a bound") if self._optional(",") else ""
            self._expect(">")
            return f"{element}[{bound}]"
        return self._named_type(word)

    def _named_type(self, word: str) -> str:
        if word in _SEVERAL_WORDS:
            while self.pos < len(self.tokens) and self.tokens[self.pos] in ("long", "short") and len(word) < 20:
                word += " " + self._next()
            return _PRIMITIVES.get(word, word)
        if word in ("string", "wstring"):
            if self._optional("<"):
                self._number("a bound")
                self._expect(">")
            return word
        if word in _PRIMITIVES:
            return _PRIMITIVES[word]
        parts = [word]
        while self._optional("::"):
            parts.append(self._name())
        return self._here(word) if len(parts) == 1 else "/".join(part for part in parts if part != "msg")
