"""Every cost term against its printed formula, written as loops over agents and components."""

import math

import pytest

from diffstack_mmv import costs
from tests.costs.test_terms import random_case

GRAVITY = 9.81


def agents_of(problem, row, time):
    """Weight, place and radius of every component of every agent who is there."""
    agents = problem.obstacles
    for number in range(agents.valid.shape[1]):
        if agents.valid[row, number]:
            radius = float(agents.radius[row, number])
            yield (
                radius,
                [
                    (float(weight), place)
                    for weight, place in zip(
                        agents.weight[row, number],
                        agents.position[row, number, :, time].tolist(),
                        strict=True,
                    )
                ],
            )


class At:
    """One sample at one time, in plain numbers."""

    def __init__(self, motion, controls, problem, row, time):
        self.place = motion.position[row, time].tolist()
        self.angle = float(motion.heading[row, time])
        self.speed = float(motion.velocity[row, time, 0])
        self.yaw_rate = float(motion.yaw_rate[row, time])
        self.controls, self.last = controls[row, time].tolist(), time == controls.shape[1] - 1
        self.goal, self.wanted = problem.goal[row].tolist(), problem.reference[row, time].tolist()
        self.wanted_mps = float(problem.reference_speed[row])
        self.agents = list(agents_of(problem, row, time))
        discs = problem.ego.discs
        self.discs = list(zip(discs.ahead[row].tolist(), discs.radius[row].tolist(), strict=True))

    def seen(self, place):
        """Way to a place ahead and to the left."""
        x, y = place[0] - self.place[0], place[1] - self.place[1]
        cosine, sine = math.cos(self.angle), math.sin(self.angle)
        return cosine * x + sine * y, cosine * y - sine * x

    @property
    def away(self):
        return math.dist(self.place, self.goal)


def misaligned(at):
    ahead, left = at.seen(at.goal)
    share = at.away**2 / (at.away**2 + 0.7**2)
    return share * (1 - math.cos(math.atan2(left, ahead)))


def braking(at):
    far = math.sqrt(at.away**2 + 0.03**2) - 0.03
    stopping = math.sqrt(2 * 1.5 * far + 0.1**2) - 0.1
    allowed = smooth_max(-stopping, -at.wanted_mps, 0.1)
    return (at.speed + allowed) ** 2


def smooth_max(first, second, width):
    return (first + second + math.hypot(first - second, width)) / 2


def outside_turn(at):
    ahead, left = at.seen(at.goal)
    depths = [1.4 - math.hypot(ahead, left - side * 1.4) for side in (1, -1)]
    return sum(max(depth, 0) ** 2 for depth in depths)


def expected_collision(at):
    value = 0.0
    for _, components in at.agents:
        distance = sum(weight * math.dist(place, at.place) for weight, place in components)
        value += math.exp(-0.5 * (distance / 0.8) ** 2)
    return value


def outline(at):
    value, (ends, radii) = 0.0, zip(*at.discs, strict=True)
    for radius, components in at.agents:
        for weight, place in components:
            ahead, left = at.seen(place)
            beyond = ahead - min(max(ahead, min(ends)), max(ends))
            value += weight * max(0.6 - math.hypot(beyond, left) + max(radii) + radius, 0) ** 2
    return value


def turning_circles(at):
    turn = smooth_max(at.speed**2 / (0.3 * GRAVITY), 0.5, 0.05)
    swept = max(math.hypot(turn, ahead - 0.2) + radius for ahead, radius in at.discs)
    value = 0.0
    for radius, components in at.agents:
        for weight, place in components:
            ahead, left = at.seen(place)
            circles = [
                math.hypot(ahead - 0.2, left - side * turn) - (swept + radius + 0.15)
                for side in (1, -1)
            ]
            value += weight * max(-smooth_max(*circles, 0.05), 0) ** 2
    return value


FORMULAS = {
    "running goal": (costs.RunningGoal(), lambda at: 0.0 if at.last else at.away**2),
    "final goal": (costs.FinalGoal(), lambda at: at.away**2 if at.last else 0.0),
    "heading": (costs.HeadingToGoal(0.7), misaligned),
    "speed": (costs.ReferenceSpeed(), lambda at: (at.speed - at.wanted_mps) ** 2),
    "braking": (costs.BrakingProfile(1.5), braking),
    "tracking": (costs.ReferenceTracking(), lambda at: math.dist(at.place, at.wanted) ** 2),
    "effort": (costs.ControlEffort(), lambda at: sum(each**2 for each in at.controls)),
    "yaw rate": (costs.YawRate(), lambda at: at.yaw_rate**2),
    "lateral": (costs.LateralAcceleration(), lambda at: (at.speed * at.yaw_rate) ** 2),
    "collision": (costs.ExpectedCollision(0.8), expected_collision),
    "outline": (costs.OutlineClearance(0.6), outline),
    "circles": (costs.TurningCircleBarrier(0.5, 0.3, 0.15, 0.2), turning_circles),
    "limit": (costs.SpeedLimit(), lambda at: max(abs(at.speed) - at.wanted_mps, 0) ** 2),
    "reversing": (costs.Reversing(), lambda at: max(-at.speed, 0) ** 2),
    "outside turn": (costs.GoalOutsideTurn(1.4), outside_turn),
}


@pytest.mark.parametrize(("term", "formula"), FORMULAS.values(), ids=FORMULAS)
def test_value_is_the_formula_at_every_sample_and_time(term, formula, double):
    case = random_case()
    found = term(*case)
    for row in range(3):
        expected = [formula(At(*case, row, time)) for time in range(6)]
        assert found[row].tolist() == pytest.approx(expected, rel=1e-3, abs=2e-3)
