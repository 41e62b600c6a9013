"""Compiled kernels that no longer match their sources are dropped before they are used.

Numba keeps compiled kernels beside the sources and looks only at the file of each kernel itself: a kernel that calls
one of another file would go on using that file's old code after an update. So kernels that are older than any file
with kernels go; what is left is current. Only the default place of the cache is looked at, not NUMBA_CACHE_DIR.
"""

import importlib.util
import os
import pathlib
import re

_KERNEL = re.compile(r"^@(kernel|njit)\b", re.MULTILINE)


def any_compiled(folder: pathlib.Path | None = None) -> bool:
    """Whether kernels of `folder`, by default the package `optim`, seem to have been compiled before."""
    own_place = os.environ.get("NUMBA_CACHE_DIR")
    return bool(own_place) or any((folder or _package_folder()).rglob("__pycache__/*.nbc"))


def drop_stale(folder: pathlib.Path | None = None) -> int:
    """Delete kernels compiled before the newest source with kernels in `folder` was written; the number deleted.

    By default the folder is that of the package `optim`. What cannot be read or deleted is left alone.
    """
    folder = folder or _package_folder()
    try:
        written = [path.stat().st_mtime for path in folder.rglob("*.py") if _KERNEL.search(path.read_text("utf-8"))]
        compiled = [(path, path.stat().st_mtime) for path in folder.rglob("__pycache__/*.nb[ic]")]
    except OSError:
        return 0
    stale = [path for path, made in compiled if made < max(written, default=0.0)]
    for path in stale:
        try:
            path.unlink(missing_ok=True)
        except OSError:
            return 0
    return len(stale)


def _package_folder() -> pathlib.Path:
    spec = importlib.util.find_spec("optim")
    assert spec is not None
    assert spec.origin is not None
    return pathlib.Path(spec.origin).parent
