#!/usr/bin/env sh
# Builds the wheel, installs it in fresh environments, the core and then the stack, and tries both away from the
# sources: the core by the code of two tutorials, the stack by the way from recordings to a page.
#   sh scripts/try_wheel.sh PYTHON
set -eu
python="$1"
sources="$(pwd)"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
"$python" -m pip wheel --quiet --no-deps --wheel-dir "$folder" .
wheel="$(echo "$folder"/*.whl)"
cat > "$folder/blocks.py" <<'CODE'
import re, sys
for name in sys.argv[1:]:
    space = {}
    for code in re.findall(r"^```python\n(.*?)^```", open(name, encoding="utf-8").read(), re.S | re.M):
        exec(compile(code, name, "exec"), space)
CODE
for extra in "" "[stack]"; do
  "$python" -m venv --clear "$folder/venv"
  "$folder/venv/bin/python" -m pip install --quiet "$wheel$extra"
  "$folder/venv/bin/python" -m pip check
  (
    cd "$folder"
    PATH="$folder/venv/bin:$PATH"
    python blocks.py "$sources/docs/tutorials/solver.md" "$sources/docs/tutorials/drive.md"
    if [ -z "$extra" ]; then
      if told="$(dmmv-train 2>&1)"; then exit 1; fi
      echo "$told" | grep -F "pip install 'diffstack_mmv[stack]'"
    else
      small="data=imptc data.cache=cache"
      python -c "from pathlib import Path; from data_converters import generate_sample; generate_sample(Path('raw'))"
      dmmv-convert data=imptc data.root=raw data.cache=cache
      dmmv-train experiment=quickstart $small epochs=1 trainer.limit_train_batches=2 out=run
      dmmv-evaluate checkpoint=run/checkpoints/best.ckpt $small out=report
      dmmv-report report run out=page
      test -s page/report.html
    fi
  )
done
