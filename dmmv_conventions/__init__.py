"""What converters and stack agree on: modes, the wording of errors, the cache on disk.

Both import this package, it imports neither of them. Importing it loads nothing heavy: only
`opening` needs more than the standard library, which is trajdata.
"""
