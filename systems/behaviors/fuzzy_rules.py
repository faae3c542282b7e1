"""Simplified fuzzy inference: Gaussian terms, product of the premises, mean of the conclusions (row S4-g)."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..config import check_config, quantity
from ..errors import ConfigError

ANY = "any"
"""Stands for every term of an input."""

_GAP = 0.01
"""Between two neighbouring terms the larger membership must not fall below this."""


@dataclass(kw_only=True)
class FuzzyRule:
    """If every input is what `when` says, then the outputs are what `then` says."""

    # A term of every input, in their order, or `any`.
    when: list[str] = field(default_factory=list)
    # A number for every output, in its unit.
    then: list[float] = quantity([], unit="")


@dataclass(kw_only=True)
class FuzzyRules:
    """Terms of the inputs and the rules on them, as data."""

    # By input and term, from the lowest to the highest: centre and width of the Gaussian, in the unit of the input.
    inputs: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    rules: list[FuzzyRule] = field(default_factory=list)


class RuleBase:
    """Rules, checked and ready for inference. Read-only.

    The membership of x in a term with centre a and width b is exp(−((x − a)/b)²); below the centre of the lowest term
    and above that of the highest it is 1. A rule holds as far as the product of its premises, μ, and an output is
    Σ μ w / Σ μ over the rules' numbers w: the simplified inference of the robots of S4-g.

    Args:
        rules: the data. inputs: names that it must have, in order. outputs: how many numbers a rule gives.
        where, key: what to call it in errors.

    Raises:
        ConfigError: an input or a term is missing or unknown, a width is not positive, centres do not rise, neighbours
            leave a gap, or no rule is for a combination of terms.
    """

    def __init__(
        self, rules: FuzzyRules, inputs: tuple[str, ...], outputs: int, *, where: object = "", key: str = "rules"
    ):
        check_config(rules, where=where, key=key)
        if tuple(rules.inputs) != inputs:
            raise ConfigError(
                "wrong inputs", where=where, key=f"{key}.inputs", value=list(rules.inputs), valid=list(inputs)
            )
        if not rules.rules:
            raise ConfigError("no rules", where=where, key=f"{key}.rules", valid="at least one")
        self._terms = [_term_table(terms, where, f"{key}.inputs.{name}") for name, terms in rules.inputs.items()]
        names = [list(terms) for terms in rules.inputs.values()]
        self._most = max(len(terms) for terms in names)
        index = np.empty((len(rules.rules), len(inputs)), np.int64)
        conclusions = np.empty((len(rules.rules), outputs))
        for i, rule in enumerate(rules.rules):
            index[i], conclusions[i] = _read_rule(rule, names, outputs, self._most, where, f"{key}.rules[{i}]")
        self._index, self._conclusions = index, conclusions
        self._columns = np.arange(len(inputs))
        self._check_cover(names, where, key)

    def _check_cover(self, names: list[list[str]], where: object, key: str) -> None:
        met = np.zeros([len(terms) for terms in names], bool)
        for row in self._index:
            met[tuple(slice(None) if term == self._most else int(term) for term in row)] = True
        if not met.all():
            hole = np.argwhere(~met)[0]
            missing = [terms[i] for terms, i in zip(names, hole, strict=True)]
            raise ConfigError("a rule is missing", where=where, key=f"{key}.rules", valid=f"one for {missing}")

    def memberships(self, x: np.ndarray) -> np.ndarray:
        """Membership of every input in each of its terms, (I, T + 1), the last column being `any`."""
        table = np.ones((len(self._terms), self._most + 1))
        for i, (centres, widths) in enumerate(self._terms):
            inside = min(max(float(x[i]), centres[0]), centres[-1])
            table[i, : len(centres)] = np.exp(-(((inside - centres) / widths) ** 2))
        return table

    def infer(self, x: np.ndarray) -> np.ndarray:
        """Outputs for inputs x (I,), (O,). An input that is not a number counts as the highest that there is."""
        x = np.where(np.isnan(x), np.inf, x)
        held = self.memberships(x)[self._columns, self._index].prod(axis=1)
        outputs: np.ndarray = held @ self._conclusions / held.sum()
        return outputs


def _read_rule(
    rule: FuzzyRule, names: list[list[str]], outputs: int, any_column: int, where: object, key: str
) -> tuple[list[int], list[float]]:
    if len(rule.when) != len(names):
        raise ConfigError("wrong length", where=where, key=f"{key}.when", value=rule.when, valid=f"{len(names)} terms")
    if len(rule.then) != outputs:
        raise ConfigError("wrong length", where=where, key=f"{key}.then", value=rule.then, valid=f"{outputs} numbers")
    for term, known in zip(rule.when, names, strict=True):
        if term != ANY and term not in known:
            raise ConfigError("unknown term", where=where, key=f"{key}.when", value=term, valid=[*known, ANY])
    columns = [any_column if t == ANY else known.index(t) for t, known in zip(rule.when, names, strict=True)]
    return columns, rule.then


def _term_table(terms: dict[str, list[float]], where: object, key: str) -> tuple[np.ndarray, np.ndarray]:
    if not terms or ANY in terms:
        raise ConfigError("no terms" if not terms else "reserved name", where=where, key=key, valid="names of terms")
    for name, numbers in terms.items():
        good = len(numbers) == 2 and all(isinstance(n, (int, float)) and np.isfinite(n) for n in numbers)
        if not good or numbers[1] <= 0:
            valid = "a centre and a width > 0"
            raise ConfigError("not a term", where=where, key=f"{key}.{name}", value=numbers, valid=valid)
    for (low, (a, b)), (high, (c, d)) in pairwise(terms.items()):
        if c <= a:
            raise ConfigError("centres must rise", where=where, key=f"{key}.{high}", value=c, valid=f"> {a:g}")
        middle = (a * d + c * b) / (b + d)  # where both are equal
        if np.exp(-(((middle - a) / b) ** 2)) < _GAP:
            raise ConfigError("a gap between terms", where=where, key=key, value=f"{low}, {high}", valid="wider terms")
    table = np.array(list(terms.values()), float)
    return table[:, 0], table[:, 1]
