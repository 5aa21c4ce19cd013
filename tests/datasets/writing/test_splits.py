"""Units stay in their split, and there is always something to learn from and something to test on."""

from hypothesis import given
from hypothesis import strategies as st

from gym_open.datasets.writing.splits import assign, unit_of
from gym_open.formats.releases.layout import Split

UNITS = st.sets(st.text("abcdef0123456789", min_size=1, max_size=6), max_size=30)
FRACTIONS = st.floats(0, 1)
SEEDS = st.integers(0, 5)


@given(UNITS, FRACTIONS, SEEDS)
def test_shares(units: set[str], fraction: float, seed: int) -> None:
    splits = assign(units, fraction, seed)
    assert set(splits) == units
    val = sum(split == "val" for split in splits.values())
    if len(units) < 2 or fraction == 0:
        assert val == 0
    else:
        assert 1 <= val <= len(units) - 1
        assert abs(val - fraction * len(units)) <= 1


@given(UNITS, UNITS, FRACTIONS, SEEDS)
def test_known_units_never_move(old: set[str], new: set[str], fraction: float, seed: int) -> None:
    before = assign(old, fraction, seed)
    after = assign(old | new, fraction, seed, before)
    assert {unit: after[unit] for unit in old} == before
    assert set(after) == old | new
    if after:
        assert "train" in after.values()
    if len(after) > 1 and fraction > 0 and len(new - old):
        assert "val" in after.values()


@given(SEEDS)
def test_what_comes_late_is_not_held_out_where_something_is(seed: int) -> None:
    known: dict[str, Split] = {"a": "train", "b": "val"}
    assert assign({"c", "d"}, 0.01, seed, known) == {**known, "c": "train", "d": "train"}


@given(UNITS, FRACTIONS, SEEDS)
def test_the_order_of_logs_decides_nothing(units: set[str], fraction: float, seed: int) -> None:
    assert assign(sorted(units), fraction, seed) == assign(sorted(units, reverse=True), fraction, seed)


def test_the_seed_decides() -> None:
    units = [str(i) for i in range(20)]
    held: set[frozenset[str]] = set()
    for seed in range(5):
        splits: dict[str, Split] = assign(units, 0.5, seed)
        held.add(frozenset(unit for unit, split in splits.items() if split == "val"))
    assert len(held) == 5


def test_a_unit_is_a_layout_or_a_stream() -> None:
    assert unit_of("world", 3, "abc") == "abc"
    assert unit_of("stream", 3, "abc") == "3"
