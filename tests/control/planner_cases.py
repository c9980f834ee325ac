"""Writes what the planner's control answers in a number of situations, bit for bit."""

import random
import sys

from bench.control.genetic import Breeding
from bench.control.planner import Motion, Planner, PlatoonGoal
from bench.control.settings import GeneticSettings, PlannerSettings
from platoon_fmu.parameters import VehicleParameters


def answers(cases: int) -> list[str]:
    """What a planner asks for, its gains and their cost, in a platoon near enough to feel all forces."""
    dice = random.Random(1)
    lines = []
    for case in range(cases):
        search = GeneticSettings(population=6, generations=2, horizon_steps=8, horizon_step_s=0.02 + 0.01 * (case % 8))
        each = Planner(
            PlannerSettings(genetic=search, speed_min_mps=1.0),
            PlatoonGoal(7.0, 20.0, 10.0),
            VehicleParameters(),
            1,
            4,
            case,
            0.01,
        )
        motions = {
            number: Motion(
                dice.uniform(-15, 15), dice.uniform(0, 9), dice.uniform(1, 30), dice.gauss(0, 0.5), dice.gauss(0, 0.3)
            )
            for number in (1, 2, 3, 4)
        }
        each.assign_slots(motions, 0.0)
        others = {number: motion for number, motion in motions.items() if number != 1}
        for cycle in range(10):
            out = each.step(cycle, 0.01 * cycle, motions[1], motions[1].speed, others)
            values = (out.v_x, out.yaw_rate, out.margin, out.cost, *out.target, *out.gains)
            lines.append(" ".join([str(int(out.limit)), str(out.neighbours), *(float(x).hex() for x in values)]))
    lines.append(" ".join(float(x).hex() for x in Breeding(GeneticSettings()).middle()))
    return lines


def main() -> None:
    sys.stdout.write("\n".join(answers(12)))
