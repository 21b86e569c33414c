"""Memory that a process frees and soon needs again, and objects that it never frees."""

import ctypes
import gc

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
LARGEST_BYTES = 2**30


def keep_freed() -> bool:
    """Have the process keep memory that it frees, up to 2 GiB, for what it allocates next.

    The C library of Linux gives large blocks back at once, and the kernel clears each page when it
    is touched again: tens of milliseconds in a step that takes a few hundred. Whether this C
    library can be told so.
    """
    try:
        tell = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # musl, macOS; Windows has no library of itself
        return False
    trimmed = tell(M_TRIM_THRESHOLD, 2 * LARGEST_BYTES - 1)
    return bool(trimmed and tell(M_MMAP_THRESHOLD, LARGEST_BYTES))


def leave_alone() -> None:
    """Have Python's search for garbage leave out all objects that there are now.

    Modules and configuration are a million objects that stay to the end. A full search goes through
    all of them, which takes longer than a step of training.
    """
    gc.collect()
    gc.freeze()
