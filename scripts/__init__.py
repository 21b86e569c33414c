"""The command lines; each file is one command, and `--help` explains it."""
