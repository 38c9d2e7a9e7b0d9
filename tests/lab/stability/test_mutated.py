"""A hundred of the files that mutated.py makes by thousands."""

from mutated import read_mutated


def test_mutated_photographs_are_read_or_refused():
    outcomes = list(read_mutated(110, seed=1))
    assert {outcome for _, outcome in outcomes} == {"read", "refused"}
