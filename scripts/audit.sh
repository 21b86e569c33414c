#!/usr/bin/env sh
# Looks up the locked versions among the known vulnerabilities, with pip-audit in an environment of its own.
set -eu
python="$1"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
reach="import urllib.request as u; u.urlopen('https://pypi.org/pypi/pip/json', timeout=10).read(1)"
if ! "$python" -c "$reach" > /dev/null 2>&1; then
  echo "make audit needs https://pypi.org, which tells the known vulnerabilities and cannot be reached from here." >&2
  echo "Nothing was audited. Run it again where there is a network." >&2
  exit 1
fi
"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet "pip-audit>=2.7,<3"
# strict: a package that the service does not know counts as a failure, not as harmless
"$folder/venv/bin/pip-audit" --strict --disable-pip --no-deps --requirement requirements.lock
