"""Dynamics by their names: the files of `configs/dynamics`, in a checkout and installed."""

import shutil

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from diffstack_mmv.dynamics import DiffGM3, DiffKBM, SoftplusFloor, catalogue
from diffstack_mmv.dynamics.catalogue import dynamics_names, load_dynamics, model_of
from diffstack_mmv.dynamics.gm3 import PaperBrush
from diffstack_mmv.vehicles import config_folder, load_vehicle
from dmmv_conventions.config_files import settings_of


@pytest.mark.parametrize("name", dynamics_names())
def test_every_file_builds_the_model_of_a_vehicle(name):
    model = model_of("bicycle", name, 0.05)
    assert model.dt_s == 0.05
    assert model.bounds.upper[1 if name == "unicycle" else 0] > 0


def test_a_file_that_builds_on_another_keeps_both_settings():
    model = model_of("bicycle", "gm3_paper", 0.1)
    assert isinstance(model, DiffGM3)
    assert isinstance(model.chassis.tire, PaperBrush)
    assert model.substeps == 1


def test_each_model_has_a_vehicle_of_its_own():
    build = load_dynamics("kbm")
    bicycle, scooter = (build(spec=load_vehicle(n), dt_s=0.1) for n in ("bicycle", "scooter"))
    assert bicycle.wheelbase().item() != scooter.wheelbase().item()


def test_an_unknown_name_is_refused_with_all_names():
    with pytest.raises(
        ValueError,
        match="`dynamics` must be one of gm3, gm3_coordinated, gm3_fine, gm3_paper, holonomic",
    ):
        load_dynamics("magic")


@pytest.mark.parametrize("name", dynamics_names())
def test_files_are_composed_as_by_hydra(name):
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        composed = compose(overrides=[f"+dynamics={name}"]).dynamics
    settings = settings_of(name, config_folder() / "dynamics")
    assert settings == OmegaConf.to_container(composed, resolve=False)


def test_installed_files_are_found_as_well(monkeypatch, tmp_path):
    installed = tmp_path / "diffstack_mmv_configs"
    shutil.copytree(config_folder() / "dynamics", installed / "dynamics")
    (installed / "dynamics" / "mine.yaml").write_text("defaults: [kbm_smooth]\n")
    monkeypatch.setattr(catalogue, "config_folder", lambda: installed)
    assert "mine" in dynamics_names()
    model = model_of("bicycle", "mine", 0.1)
    assert isinstance(model, DiffKBM)
    assert isinstance(model.floor, SoftplusFloor)
