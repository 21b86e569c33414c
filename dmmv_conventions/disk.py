"""Telling a full disk from other failures of a file system."""

import errno


def disk_is_full(error: OSError) -> bool:
    """Whether no space, or no quota, is left."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)
