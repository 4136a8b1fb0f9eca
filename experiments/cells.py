"""Figures of one row as text for a Markdown table.

Several tables of a row are several training seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.stats import down, percent_down, percent_up, up
from experiments.tables import Table

Tables = Mapping[str, Table]

__all__ = [
    "Tables",
    "bad",
    "costs",
    "decision",
    "down",
    "good",
    "head",
    "line",
    "median",
    "problems",
    "share",
    "up",
    "values",
]


def head(*names: str) -> list[str]:
    """The first two lines of a table."""
    return [line(*names), line(*["---"] * len(names))]


def line(*texts: str) -> str:
    """One line of a table."""
    return "| " + " | ".join(texts) + " |"


def good(of: Sequence[Table], radius: str, name: str) -> str:
    """A share that should be large, with its interval."""
    return _share([table[radius][name] for table in of if radius in table], better=True)


def bad(of: Sequence[Table], radius: str, name: str) -> str:
    """A share that should be small."""
    return _share([table[radius][name] for table in of if radius in table], better=False)


def _share(rates: Sequence[Mapping[str, Any]], *, better: bool) -> str:
    if not rates:
        return "not run"
    show = percent_down if better else percent_up
    whole = show(sum(each["count"] for each in rates), sum(each["of"] for each in rates))
    if len(rates) == 1:
        low, high = rates[0]["low"] * 100, rates[0]["high"] * 100
    else:
        low, high = (100 * pick(each["rate"] for each in rates) for pick in (min, max))
    return f"{whole} ({down(low)}-{up(high) if not better else down(high)})"


def share(each: Mapping[str, Any], *, better: bool = True) -> str:
    """One share with its interval."""
    return _share([each], better=better)


def problems(of: Sequence[Table]) -> str:
    """How many problems a row was measured on; of several seeds the fewest."""
    return f"{min(table['problems']['episodes'] for table in of):,}"


def median(
    found: Mapping[str, Any] | None, *, scale: float = 1.0, digits: int = 1, small: bool = True
) -> str:
    """A median with its interval; `small` for what should be small."""
    if found is None:
        return "-"
    show = up if small else down
    middle, low, high = (show(scale * found[key], digits) for key in ("median", "low", "high"))
    return f"{middle} ({low}-{high})"


def values(
    of: Sequence[Table],
    name: str,
    *keys: str,
    scale: float = 1.0,
    digits: int = 1,
    small: bool = False,
) -> str:
    """Figures at 3 cm, the mean over seeds, separated by strokes.

    `small` for what should be small.
    """
    show = up if small else down
    found = [table["3 cm"][name] for table in of if table["3 cm"].get(name)]
    if not found:
        return "-"
    return " / ".join(
        show(scale * sum(each[key] for each in found) / len(found), digits) for key in keys
    )


def decision(of: Sequence[Table]) -> str:
    """Processor time of a decision [µs], and of planning before the first one [ms] where there is
    any to speak of.
    """
    found = [table["decision"] for table in of if table.get("decision")]
    if not found:
        return "-"
    act = max(each["act"]["median"] for each in found) if found[0].get("act") else None
    begin = max(each["begin"]["median"] for each in found)
    shown = "" if act is None else up(1e6 * act, 0)
    return shown + (f" + {up(1e3 * begin)} ms" if begin > 1e-3 else "")


def costs(of: Sequence[Table]) -> list[str]:
    """What training took, one sentence part per table that knows."""
    lines = []
    for table in of:
        cost = table["policy"].get("cost")
        if cost:
            what = f"{cost['updates']:,} updates" + (
                f" and {cost['steps']:,} live steps" if cost["steps"] else ""
            )
            lines.append(f"{table['scene']}: {what} in {up(cost['seconds'] / 60)} min")
    return lines
