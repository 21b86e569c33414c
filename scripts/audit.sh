#!/usr/bin/env sh
# Looks up the locked versions among the known vulnerabilities, with pip-audit in an environment of its own.
set -eu
python="$1"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
# what pip-audit will ask for each package; a mirror of the registry may know the package and not this
if ! told="$("$python" - requirements.lock 2>&1 <<'CODE'
import json, re, sys, urllib.request
text = open(sys.argv[1], encoding="utf-8").read()
url = "https://pypi.org/pypi/{}/{}/json".format(*re.search(r"^([\w.-]+)==([\w.]+)", text, re.M).groups())
try:
    with urllib.request.urlopen(url, timeout=10) as answer:
        json.load(answer)["vulnerabilities"]
except (OSError, ValueError, KeyError) as error:
    sys.exit(f"make audit needs {url}, which tells known vulnerabilities, but got {error!r}.")
CODE
)"; then
  echo "$told" >&2
  echo "Nothing was audited. Run it again where the advisory service of PyPI can be reached." >&2
  exit 1
fi
"$python" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet "pip-audit>=2.7,<3"
# strict: a package that the service does not know counts as a failure, not as harmless
"$folder/venv/bin/pip-audit" --strict --disable-pip --no-deps --requirement requirements.lock
