"""Logs as files of this machine. Those in an object store are listed, and fetched once each into a cache (extra `s3`).

The client of a store knows its address and our identity (for S3: AWS_ENDPOINT_URL, AWS_PROFILE, ...).
"""

import hashlib
import os
import pathlib
from typing import Any

from replay.base.errors import ReplayError

STORES = ("s3://",)
"""Beginnings of addresses in object stores."""
STORE_ERROR = "E_STORE"


def local_file(path: str) -> pathlib.Path:
    """The file of a log; for an address in an object store, a copy of the object. Raises ReplayError (E_STORE)."""
    return fetched(path) if path.startswith(STORES) else pathlib.Path(path)


def digest(path: str) -> str | None:
    """SHA-256 of a local file in hexadecimal digits; None where it cannot be read, and for an object store."""
    if path.startswith(STORES):
        return None
    try:
        if not os.path.isfile(path):  # noqa: PTH113 - a pipe would block
            return None
        with pathlib.Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def find_objects(where: str, suffix: str) -> list[tuple[str, str]]:
    """Name and address of each object below a prefix whose name ends with `suffix`. Raises ReplayError (E_STORE)."""
    system, root = _system(where)
    scheme = where.partition("://")[0]
    try:
        found = [root] if root.endswith(suffix) else sorted(system.find(root))
    except Exception as error:  # clients raise errors of many libraries
        raise _failed(where, error) from error
    base = root.rpartition("/")[0] if root.endswith(suffix) else root.rstrip("/")
    paths = [path for path in found if path.endswith(suffix)]
    return [(path.removeprefix(base + "/").removesuffix(suffix), f"{scheme}://{path}") for path in paths]


def fetched(address: str) -> pathlib.Path:
    """Copy an object to this machine, again where the object has changed. Raises ReplayError (E_STORE)."""
    import fsspec

    cache = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "replay" / "objects"
    scheme = address.partition("://")[0]
    options: dict[str, Any] = {"cache_storage": str(cache), "check_files": True}
    targets: dict[str, Any] = {scheme: {"use_listings_cache": False}}
    try:
        return pathlib.Path(str(fsspec.open_local(f"filecache::{address}", filecache=options, **targets)))
    except Exception as error:  # as above
        raise _failed(address, error) from error


def _system(where: str) -> tuple[Any, str]:
    try:
        import fsspec

        return fsspec.core.url_to_fs(where)
    except ImportError as error:
        hint = "pip install 'truck-trailer-replay[s3]'"
        raise ReplayError(STORE_ERROR, f"{where}: reading object stores needs the extra s3: {hint}") from error
    except ValueError as error:
        raise _failed(where, error) from error


def _failed(where: str, error: Exception) -> ReplayError:
    words = " ".join(str(error).split()) or type(error).__name__
    return ReplayError(STORE_ERROR, f"{where}: {type(error).__name__}: {words}")
