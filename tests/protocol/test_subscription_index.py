"""The index of listeners finds whom a comparison with every expression finds."""

import random

import pytest

from protocol.keys import matches
from protocol.subscription_index import SubscriptionIndex

EXPRESSIONS = ["covey/r/a/1", "covey/r/a/2", "covey/r/b/1", "covey/r/a/*", "covey/r/b/*", "covey/r/**", "covey/*/a/1", "covey/r/b/*/1"]


@pytest.mark.parametrize("expressions", [EXPRESSIONS, EXPRESSIONS[:5]])  # without the rare ones the listeners of a key change one by one
def test_it_finds_the_listeners_that_a_comparison_with_every_expression_finds(expressions: list[str]) -> None:
    keys = ["covey/r/a/1", "covey/r/a/2", "covey/r/b/1", "covey/r/b/7/1", "covey/r/b/8/1", "covey/q/a/1"]
    for seed in range(20):
        print(f"seed {seed}")
        dice, index = random.Random(seed), SubscriptionIndex[int](lambda number: number)
        wanted: set[tuple[str, int]] = set()
        for _ in range(200):
            expression, listener = dice.choice(expressions), dice.randrange(5)
            if (expression, listener) in wanted:
                wanted.remove((expression, listener))
                index.remove(expression, listener)
            else:
                wanted.add((expression, listener))
                index.add(expression, listener)
            for key in keys:
                assert index.listeners(key) == sorted({number for words, number in wanted if matches(words, key)})
