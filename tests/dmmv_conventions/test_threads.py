"""Work is shared among as many threads as there are, and touches no memory of others."""

import subprocess
from pathlib import Path

import pytest

from dmmv_conventions.libraries import CannotBuildError, _compiler, header

PROGRAM = """
#include <sys/resource.h>
int main() {
  const rlimit memory{256u << 20, 256u << 20};  // of which each thread takes some for its calls
  setrlimit(RLIMIT_AS, &memory);
  std::atomic<long> sum{0};
  dmmv::for_each(1000, 900, [&](long i) { sum += i; });
  return sum == 499500 ? 0 : 1;
}
"""
PARTIAL = """
int main() {
  const long units = 2 * LANES + 1;
  const std::vector<long> rows{4, 0, 2};
  std::vector<Real> from(5 * units), back(5 * units);
  for (size_t i = 0; i < from.size(); ++i) from[i] = Real(i);
  Rows block(units * WIDE);
  const Block three{0, 0, 3, rows.data()};
  three.take(from.data(), units, units, block.data());
  three.give(block.data(), units, back.data(), units);
  for (long row = 0; row < 5; ++row)
    for (long i = 0; i < units; ++i)
      if (back[row * units + i] != (row % 2 ? Real(0) : from[row * units + i])) return 1;
  return 0;
}
"""


def built(source: str, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Build a program, where there is a compiler."""
    try:
        compiler = _compiler()
    except CannotBuildError as failure:
        pytest.skip(str(failure))
    written = folder / "program.cpp"
    written.write_text(source)
    options = "-std=c++20", "-march=native", "-pthread", "-Wno-psabi", *flags
    command = [compiler, *options, written, "-o", folder / "program"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def ran(source: str, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Build a program and run it."""
    if flags and built("int main() {}", folder, *flags).returncode:
        pytest.skip(f"the compiler has no {' '.join(flags)}")
    done = built(source, folder, *flags)
    assert done.returncode == 0, done.stderr
    program = [folder / "program"]
    return subprocess.run(program, capture_output=True, text=True, check=False, timeout=60)


def test_a_machine_without_more_threads_does_the_work_with_those_that_are_there(tmp_path):
    """The whole process ended, as it does in a container that may have no more of them."""
    done = ran(header("dmmv_conventions", "threads") + PROGRAM, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("real", ["float", "double"])
def test_a_block_that_is_not_full_reads_no_rows_beyond_its_own(real, tmp_path):
    """The numbers of rows end with the last one that there is."""
    lanes = header("diffstack_mmv.prediction.trajectron", "lanes")
    parts = f"typedef {real} Real;", header("dmmv_conventions", "threads"), lanes, PARTIAL
    done = ran("\n".join(parts), tmp_path, "-fsanitize=address,undefined", "-fno-sanitize-recover")
    assert done.returncode == 0, done.stderr
