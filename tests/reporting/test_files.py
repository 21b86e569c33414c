"""Results that are lost, cut off or changed: told by their file."""

import pandas as pd
import pytest

from diffstack_mmv.reporting.files import read_json, read_parquet, told_as_broken, write_parquet


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 100_000, b"\xff\xfe", b"[1]", b"7"])
def test_what_is_no_json_object_is_told(content, tmp_path):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"`.*a\.json` must"):
        read_json(tmp_path / "a.json")


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_table_that_was_cut_off_is_told(share, tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(path, pd.DataFrame({"x": range(50)}))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"`.*a\.parquet` must be as this version writes it"):
        read_parquet(path)


@pytest.mark.parametrize("error", [KeyError("modes"), TypeError("no mapping"), ValueError("'x'")])
def test_what_a_reader_stumbles_over_is_the_fault_of_the_file(error, tmp_path):
    told = f"`{tmp_path}` must be.*{type(error).__name__}"
    with pytest.raises(ValueError, match=told), told_as_broken(tmp_path):
        raise error


def test_a_message_that_names_the_fault_stays(tmp_path):
    with pytest.raises(ValueError, match="`x` must be positive"), told_as_broken(tmp_path):
        raise ValueError("`x` must be positive")


@pytest.mark.parametrize("read", [read_json, read_parquet])
def test_a_result_that_is_not_there_is_told_with_the_step_that_writes_it(read, tmp_path):
    with pytest.raises(ValueError, match=r"`.*gone` must exist.*Run the step that writes it"):
        read(tmp_path / "gone")
