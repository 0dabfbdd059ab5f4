"""Rows of the scanner's tables: what, measured, target, whether it is met; and which are asked."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from synthgen.errors import ConfigError, nearest

Row = list[Any]
Test = Callable[[Path], list[Row]]
COLUMNS = ["what", "measured", "target", "met"]
OWN = "(own)"
"""Marks a target that is ours, not the project's."""


def row(
    what: str, value: float, low: float | None = None, high: float | None = None, *,
    own: bool = False,
) -> Row:  # fmt: skip
    """Return one row; without bounds it only informs."""
    if low is None and high is None:
        return [what, value, "", ""]
    met = (low is None or value >= low) and (high is None or value <= high)
    target = (
        f"{low:g}..{high:g}" if low is not None and high is not None
        else f"<= {high:g}" if low is None else f">= {low:g}"
    )  # fmt: skip
    return [what, value, f"{target} {OWN}" if own else target, "yes" if met else "NO"]


def run_tests(
    tests: Mapping[str, Test], asked: Sequence[str], pictures: Path, title: str
) -> dict[str, Any]:
    """Run the tests that are asked for, all without a choice, and put their rows into one table.

    Raises
    ------
    ConfigError
        If a test is asked for that is not there.
    """
    for name in asked:
        if name not in tests:
            raise ConfigError(
                f"no rows {name!r}{nearest(name, list(tests))}; there are {', '.join(tests)}"
            )
    chosen = [name for name in tests if not asked or name in asked]
    pictures.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True)
    columns = TextColumn("{task.description:12}"), BarColumn(), TimeElapsedColumn()
    rows, spent = [], {}
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=len(chosen))
        for name in chosen:
            bar.update(task, description=name)
            begun = time.process_time()
            rows += tests[name](pictures)
            spent[name] = time.process_time() - begun
            bar.advance(task)
    missed = sum(r[-1] == "NO" for r in rows)
    return {
        "title": title,
        "columns": COLUMNS,
        "rows": rows,
        "notes": [
            f"{sum(r[-1] == 'yes' for r in rows)} targets met, {missed} missed; {OWN}: a bound of "
            "this benchmark, where the project sets none",
            "CPU s: " + ", ".join(f"{name} {value:.0f}" for name, value in spent.items())
            + f"; together {sum(spent.values()):.0f}",
            f"pictures: {pictures}",
        ],
    }  # fmt: skip
