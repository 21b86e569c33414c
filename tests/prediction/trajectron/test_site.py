"""What a predictor learns of a place holds at that place alone."""

import pytest
import torch

from diffstack_mmv.geometry import motion_in_frame, position_from_frame
from diffstack_mmv.prediction.trajectron import Site
from diffstack_mmv.types import Pose
from tests.prediction.samples import scene, trajectron


def pose(x, y, heading, count=3, known=True):
    position = torch.tensor([x, y], dtype=torch.float32).expand(count, 2)
    return Pose(position, torch.full((count,), heading), torch.full((count,), known))


def located(site=True):
    torch.manual_seed(3)
    return trajectron(site=Site(scale_m=10.0) if site else None).eval()


@pytest.mark.parametrize("site", [True, False])
def test_the_forecast_depends_on_the_place_where_the_site_is_seen(site):
    model, batch = located(site), scene()
    here = model.predict(batch._replace(frame=pose(0.0, 0.0, 0.0))).mean
    there = model.predict(batch._replace(frame=pose(4.0, -3.0, 1.0))).mean
    assert torch.equal(here, there) is not site


def test_a_place_that_is_not_known_is_as_none_at_all():
    model, batch = located(), scene()
    unknown = model.predict(batch._replace(frame=pose(4.0, -3.0, 1.0, known=False)))
    assert torch.equal(unknown.mean, model(batch.ego_past, batch.neighbors_past).mean)


def test_the_same_agents_in_another_frame_get_the_same_forecast():
    model, batch = located(), scene()
    here = model.predict(batch._replace(frame=pose(2.0, 1.0, 0.5)))

    origin, turn = torch.tensor([3.0, -2.0]), torch.tensor(0.7)

    def moved(tracks):
        return tracks._replace(motion=motion_in_frame(tracks.motion, origin, turn))

    place = position_from_frame(origin, torch.tensor([2.0, 1.0]), torch.tensor(0.5))
    frame = pose(*place.tolist(), 0.5 + 0.7)
    other = batch._replace(
        ego_past=moved(batch.ego_past), neighbors_past=moved(batch.neighbors_past), frame=frame
    )
    torch.testing.assert_close(model.predict(other).log_weight, here.log_weight)


def test_a_site_in_a_map_grid_is_known_as_well_as_one_at_the_origin():
    torch.manual_seed(3)
    here, there = Site(), Site(center_m=(511570.3, 5535358.6))
    there.network.load_state_dict(here.network.state_dict())
    place = Pose(torch.rand(5, 2).double(), torch.rand(5).double(), torch.ones(5).bool())
    moved = place._replace(position=place.position + there.center)
    assert there.center.tolist() == [511570.3, 5535358.6]
    torch.testing.assert_close(there.eval()(moved), here.eval()(place))


def test_in_training_some_codes_are_left_out():
    site = Site(dropout=0.5).train()
    silent = (site(pose(1.0, 2.0, 0.3, count=400)) == 0).all(-1).float().mean()
    assert 0.4 < silent < 0.6


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ({"center_m": [1.0]}, "`center_m` must have two entries"),
        ({"scale_m": 0.0}, "`scale_m` must be positive"),
        ({"outputs": 0}, "`outputs` must be at least 1"),
        ({"dropout": 1.0}, "`dropout` must lie in"),
    ],
)
def test_wrong_settings_are_named(setting, told):
    with pytest.raises(ValueError, match=told):
        Site(**setting)
