#!/usr/bin/env sh
# Writes requirements.lock: the exact versions that satisfy pyproject.toml today, tests and linters included.
# `torch` is locked without a build tag, so that a machine without a GPU may take a build without CUDA.
set -eu
python="$1"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet "torch==2.13.0" ".[test,lint,crowd]"
{
  echo "# Exact versions for Python 3.11 and 3.12; written by \`make lock\`."
  "$folder/venv/bin/python" -m pip freeze --exclude diffstack_mmv | sed 's/+cpu//' | sort -f
  "$folder/venv/bin/python" -m pip freeze --all | grep "^setuptools"
} > requirements.lock
