"""One table from many drives through crowds, with paired tests between its rows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from diffstack_mmv.reporting.closed_loop import score_cells
from diffstack_mmv.reporting.files import read_json, write_text
from diffstack_mmv.reporting.paired import CASES, paired_cases, paired_table, require_same
from diffstack_mmv.reporting.scores import Scores
from diffstack_mmv.reporting.table import NONE, cell, markdown_table, write_table

SHOWN = (
    "success_rate",
    "collision_rate",
    "incomplete_rate",
    "nav_time_s",
    "discomfort_frequency",
    "mean_episode_min_dist_m",
)
FAILURES = ("cases of", "row", "case", "outcome", "time [s]", "avoidable")


class DrivenRow(NamedTuple):
    """A drive and its place in the table."""

    place: str  # rows of one place drive the same cases
    name: str
    folder: Path
    against: tuple[str, ...]  # rows of the same place that it is compared with, case by case

    @property
    def result(self) -> Path:
        """The file that tells how the drive ended."""
        return self.folder / "closed_loop.json"


def joint_table(rows: Sequence[DrivenRow], scores: Scores) -> pd.DataFrame:
    """One line per drive: shares with intervals of 95 %, times in s, distances in m.

    Args:
        rows: The drives; one that has not ended has a line without numbers.
        scores: Titles and units.
    """
    return pd.DataFrame([_line(row, scores) for row in rows]).fillna(NONE)


def joint_pairs(rows: Sequence[DrivenRow], scores: Scores) -> pd.DataFrame:
    """Paired tests of the rows that ask for them: McNemar and Wilcoxon, see `paired_cases`.

    Raises:
        ValueError: Two rows that are to be compared drove other cases.
    """
    ended = {(row.place, row.name): row for row in rows if row.result.is_file()}
    told = []
    for row in rows:
        others = [ended[row.place, name] for name in row.against if (row.place, name) in ended]
        for other in others if (row.place, row.name) in ended else ():
            own, its = read_json(row.result), read_json(other.result)
            require_same(CASES, own, its, "against", other.folder)
            pair = {"other": other.name} | paired_cases(own["cases"], its["cases"])
            [tests] = paired_table([pair], scores).to_dict("records")
            told.append({"cases of": row.place, "row": row.name} | tests)
    return pd.DataFrame(told)


def joint_failures(rows: Sequence[DrivenRow]) -> pd.DataFrame:
    """The cases without success, one line each; `avoidable` as `AvoidanceSearch` tells it."""
    told = []
    for row in (row for row in rows if row.result.is_file()):
        for case in _cases(row):
            if case["outcome"] != "success":
                line = {"cases of": row.place, "row": row.name, "case": case["case"]}
                line |= {"outcome": case["outcome"], "time [s]": cell(case["time_s"])}
                told.append(line | {"avoidable": cell(case.get("avoidable"))})
    # named also where nothing failed: a file without a column is none
    return pd.DataFrame(told, columns=list(FAILURES))


def write_joint_table(
    folder: Path, title: str, rows: Sequence[DrivenRow], scores: Scores, remarks: Sequence[str] = ()
) -> None:
    """Write `table.md`, `table.tex` and `table.csv`, and `failures.csv`, into a folder."""
    table, pairs = joint_table(rows, scores), joint_pairs(rows, scores)
    parts = [f"# {title}", markdown_table(table)]
    if len(pairs):
        parts.append(f"Paired, row minus the other ({_tests(pairs)}):\n\n{markdown_table(pairs)}")
    parts.append("\n".join(f"- {remark}" for remark in remarks))
    write_table(folder, "table", table, "\n\n".join(part for part in parts if part) + "\n")
    write_text(folder / "failures.csv", str(joint_failures(rows).to_csv(index=False)))


def _tests(pairs: pd.DataFrame) -> str:
    """How many tests there are, and from where on one of them would not be chance."""
    told = pairs.filter(regex=r"^p \(") != NONE
    count = max(int(told.to_numpy().sum()), 1)
    return f"{count} p values, not corrected; by Bonferroni 0.05 is {0.05 / count:.2g}"


def _cases(row: DrivenRow) -> list[dict[str, Any]]:
    return read_json(row.result)["cases"]


def _line(row: DrivenRow, scores: Scores) -> dict[str, str]:
    """The cells of one drive."""
    line = {"cases of": row.place, "row": row.name}
    if not row.result.is_file():
        return line
    told = read_json(row.result)
    last = told["first_case"] + told["n"] - 1
    line |= {"n": str(told["n"]), "cases": f"{told['phase']} {told['first_case']}–{last}"}
    line |= score_cells(told, {name: scores[name] for name in SHOWN})
    line["feasible: n, success, collision"] = _feasible(told)
    line["footprint"] = str(told["footprint"])
    line["solved"] = cell(told.get("solved_share"))
    line["real-time factor"] = f"{told['real_time_factor']:.1f}"
    return line


def _feasible(told: Mapping[str, Any]) -> str:
    """Scores without the cases that no drive passed."""
    if "feasible" not in told:
        return NONE
    left = told["feasible"]
    return f"{left['n']}, {cell(left['success_rate'])}, {cell(left['collision_rate'])}"
