"""Collisions, losses and solutions of plans."""

import math

import pytest
import torch

from diffstack_mmv.metrics import collided, planning_loss, solved, total_cost
from diffstack_mmv.metrics.planning import human_collided
from diffstack_mmv.types import Discs, Motion, Obstacles, Plan, Solution, SolverStatus
from tests.metrics.samples import tracks


def standing_agent(x, y, valid=True):
    return Obstacles(
        torch.tensor([x, y]).expand(1, 1, 1, 31, 2),
        torch.ones(1, 1, 1),
        torch.full((1, 1), 0.3),
        torch.tensor([[valid]]),
    )


def straight_plan():
    return torch.stack([torch.linspace(0, 10, 31), torch.zeros(31)], -1).unsqueeze(0)


def hit_by(position, radius, agents, heading=None, reach=0.0):
    """Whether vehicles of this radius hit an agent; their discs lie at ± reach on the axis."""
    ahead = torch.tensor([-reach, reach]).expand(*radius.shape, 2)
    discs = Discs(ahead, radius.unsqueeze(-1).expand(ahead.shape))
    heading = torch.zeros_like(position[..., 0]) if heading is None else heading
    return collided(position, heading, discs, agents)


@pytest.mark.parametrize(
    ("x", "y", "valid", "expected"),
    [
        (5.0, 0.5, True, True),
        (5.0, 0.7, True, False),
        (5.0, 0.0, False, False),
        (20.0, 0.0, True, False),
    ],
)
def test_plan_collides_where_discs_overlap(x, y, valid, expected):
    hit = hit_by(straight_plan(), torch.tensor([0.3]), standing_agent(x, y, valid))
    assert hit.tolist() == [float(expected)]


@pytest.mark.parametrize(("heading", "expected"), [(0.0, False), (math.pi / 2, True)])
def test_a_long_vehicle_is_its_outline_and_not_a_disc(heading, expected):
    plan, radius = straight_plan(), torch.tensor([0.3])
    turned = torch.full((1, 31), heading)
    beside = standing_agent(5.0, 1.2)
    assert hit_by(plan, radius, beside, turned, reach=0.8).tolist() == [float(expected)]


@pytest.mark.parametrize("radii", [[0.3, 0.1], [0.1, 0.3]])
def test_the_wider_disc_of_a_vehicle_hits_as_it_passes(radii):
    discs, plan = Discs(torch.tensor([[-0.8, 0.8]]), torch.tensor([radii])), straight_plan()
    found = collided(plan, torch.zeros(1, 31), discs, standing_agent(5.0, 0.55))
    assert found.tolist() == [1.0]


def test_overlap_at_the_start_is_no_fault_of_the_plan():
    plan = straight_plan() + torch.tensor([1.0, 0.0])
    plan[:, 0] = 0.0
    assert hit_by(plan, torch.tensor([0.3]), standing_agent(-0.2, 0.0)).tolist() == [0.0]


@pytest.mark.parametrize("row", [0, 1, 2, 30])
def test_an_overlap_at_any_single_time_after_now_is_a_collision(row):
    agents = standing_agent(50.0, 0.0)
    position = agents.position.clone()
    position[..., row, :] = straight_plan()[:, row]
    met = hit_by(straight_plan(), torch.tensor([0.3]), agents._replace(position=position))
    assert met.tolist() == [float(row > 0)]


def test_collisions_equal_a_loop():
    position = torch.randn(4, 6, 2)
    agents = Obstacles(
        torch.randn(4, 3, 1, 6, 2), torch.ones(4, 3, 1), 0.4 * torch.rand(4, 3),
        torch.rand(4, 3) < 0.8,
    )  # fmt: skip
    radius = 0.4 * torch.rand(4)
    for row, hit in enumerate(hit_by(position, radius, agents).tolist()):
        expected = any(
            math.dist(position[row, t].tolist(), agents.position[row, n, 0, t].tolist())
            < float(radius[row] + agents.radius[row, n])
            for t in range(1, 6)
            for n in range(3)
            if agents.valid[row, n]
        )
        assert hit == float(expected)


@pytest.mark.parametrize("spoiler", [torch.nan, torch.inf])
def test_a_plan_that_is_not_finite_is_not_free_of_collisions(spoiler):
    plan = straight_plan().expand(2, 31, 2).clone()
    plan[1, 20] = spoiler
    agents = standing_agent(50.0, 0.0)
    found = hit_by(plan, torch.tensor([0.3, 0.3]), agents).tolist()
    assert found == pytest.approx([0.0, math.nan], nan_ok=True)


def test_a_plan_whose_heading_is_not_finite_is_not_free_of_collisions_either():
    plan, heading = straight_plan().expand(2, 31, 2), torch.zeros(2, 31)
    heading[1, 20] = torch.nan
    found = hit_by(plan, torch.tensor([0.3, 0.3]), standing_agent(50.0, 0.0), heading).tolist()
    assert found == pytest.approx([0.0, math.nan], nan_ok=True)


def ridden(valid):
    """Past and future of somebody who rides straight on, 10 m in 30 steps."""
    plan, recorded = straight_plan(), torch.tensor([valid]).expand(1, 30)
    future = tracks(plan[:, 1:].masked_fill(~recorded.unsqueeze(-1), torch.nan), recorded)
    heading = future.motion.heading.masked_fill(~recorded, torch.nan)
    future = future._replace(motion=future.motion._replace(heading=heading))
    past = torch.cat([plan[:, :1] - 5.0, plan[:, :1]], 1)
    return tracks(past, torch.ones(1, 2, dtype=torch.bool)), future


DISCS = Discs(torch.zeros(1, 1), torch.full((1, 1), 0.3))


@pytest.mark.parametrize("y", [0.0, 0.5, 0.7, 2.0])
def test_a_human_is_judged_as_a_plan_is(y):
    agents = standing_agent(5.0, y)
    found = human_collided(*ridden(True), DISCS, agents)
    assert torch.equal(found, hit_by(straight_plan(), torch.tensor([0.3]), agents))


def test_what_was_not_recorded_of_a_human_counts_as_free():
    past, future = ridden([True] * 5 + [False] * 25)
    agents = standing_agent(5.0, 0.0)
    assert human_collided(past, future, DISCS, agents).tolist() == [0.0]
    assert human_collided(*ridden(False), DISCS, agents).isnan().all()


def test_several_plans_of_each_sample_are_judged_one_by_one():
    generator = torch.Generator().manual_seed(0)
    plans = 5 * torch.randn(4, 3, 31, 2, generator=generator)
    plans[2, 1, 30], heading = torch.nan, torch.zeros(4, 3, 31)
    heading[0, 2, 5] = torch.nan
    each = Obstacles(*(field.expand(4, 3, *field.shape[1:]) for field in standing_agent(5.0, 0.0)))
    together = hit_by(plans, torch.full((4, 3), 1.0), each, heading)
    alone = hit_by(
        plans.flatten(0, 1), torch.full((12,), 1.0),
        Obstacles(*(field.flatten(0, 1) for field in each)), heading.flatten(0, 1),
    )  # fmt: skip
    assert torch.equal(together.flatten().nan_to_num(2), alone.nan_to_num(2))
    assert together.isnan().nonzero().tolist() == [[0, 2], [2, 1]]
    assert set(together.nan_to_num(2).flatten().tolist()) == {0, 1, 2}


def test_no_agents_no_collision():
    none = Obstacles(
        torch.zeros(1, 0, 1, 31, 2),
        torch.zeros(1, 0, 1),
        torch.zeros(1, 0),
        torch.zeros(1, 0, dtype=torch.bool),
    )
    assert hit_by(straight_plan(), torch.tensor([0.3]), none).tolist() == [0.0]


def test_losses_add_up_and_stay_unknown_where_a_part_is():
    cost = total_cost({"goal": torch.tensor([1.0, 2.0]), "effort": torch.tensor([0.5, 0.5])})
    loss = planning_loss(torch.tensor([3.0, torch.nan]), cost, 0.1)
    assert loss.tolist() == pytest.approx([3.15, math.nan], nan_ok=True)


def test_only_plans_whose_every_start_converged_are_solved():
    done, open_ = int(SolverStatus.CONVERGED), int(SolverStatus.ITERATION_LIMIT)
    status = torch.tensor([[done, done], [done, open_], [open_, open_]])
    number, rows = torch.zeros(3, 2), torch.zeros(3, 4)
    motion = Motion(rows.unsqueeze(-1).expand(3, 4, 2), rows, rows, rows)
    solution = Solution(number, number, number, number, number, status)
    plan = Plan(rows, motion, number[:, 0].long(), solution, motion, number)
    assert solved(plan).tolist() == [1.0, 0.0, 0.0]
