"""Numbers as a report writes them."""

from gym_open.evaluate.report.results import Estimate


def number(value: float, digits: int = 3) -> str:
    """`.532`, `1.000`, `−.012`: no zero before the point, as the tables of papers have it."""
    text = f"{abs(value):.{digits}f}".removeprefix("0" if digits else "")
    return f"−{text}" if value < 0 and text.strip(".0") else text


def interval(estimate: Estimate, digits: int = 2) -> str:
    """`[.50, .56]`; nothing where there is none."""
    if estimate.low is None or estimate.high is None:
        return ""
    return f"[{number(estimate.low, digits)}, {number(estimate.high, digits)}]"


def signed(estimate: Estimate) -> str:
    """`+.023 [−.011, .054]`."""
    value = number(estimate.value)
    sign = "" if value.startswith("−") else "+"
    return f"{sign}{value} {interval(estimate, 3)}".rstrip()


def steps(value: float | None) -> str:
    """`200K`, `1.05M`, `0`."""
    if value is None:
        return "not reached"
    if value < 1000:
        return f"{value:.0f}"
    scaled, unit = (value / 1e6, "M") if value >= 999_500 else (value / 1e3, "K")
    return f"{scaled:.3g}{unit}"


def count(n: int, noun: str) -> str:
    """`1 run`, `3 runs`."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"
