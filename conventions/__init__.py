"""What converters and stack agree on: modes, the wording of errors, the cache on disk.

Both import this package, it imports neither of them. Importing it loads nothing heavy: `checks`,
`modes` and `cache` need the standard library only, `opening` needs trajdata.
"""
