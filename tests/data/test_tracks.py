"""Noise of whole tracks, as the conversion report tells it."""

import json

import pytest

from diffstack_mmv.data import ConvertedCache, recorded_noise


@pytest.fixture
def told(tmp_path):
    """A cache whose report tells this of the smoother's residual."""

    def write(**residual) -> ConvertedCache:
        folder = tmp_path / "toy"
        folder.mkdir()
        totals = {"totals": {"smoother_residual": {"bicycle": residual}}}
        (folder / "conversion_report.json").write_text(json.dumps(totals))
        return ConvertedCache("toy", str(tmp_path))

    return write


@pytest.mark.parametrize(("step_s", "share"), [(0.4, 2.0), (0.1, 1.0), (0.025, 0.5)])
def test_steps_between_sparse_samples_count_for_less(told, step_s, share):
    source = told(
        along_m=0.01, across_m=0.01, noise_along_m=0.08, noise_across_m=0.06, step_s=step_s
    )
    noise = recorded_noise(source, "bicycle", 0.1)
    assert noise == pytest.approx((0.08 * share, 0.06 * share))


def test_a_report_without_noise_is_warned_of(told, caplog):
    noise = recorded_noise(told(along_m=0.08, across_m=0.06), "bicycle", 0.1)
    assert noise == (0.08, 0.06)
    assert "Convert again" in caplog.text


def test_a_mode_that_was_not_recorded_has_no_noise(told):
    assert recorded_noise(told(along_m=0.08, across_m=0.06), "scooter", 0.1) is None
