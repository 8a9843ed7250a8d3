"""The language of questions: a text becomes a tree of a closed set of nodes, and nothing else happens.

    K[side=left] / K[side=right] > 1.1 and mean(K[subject, sex=f]) between 2000 and 3000

Two levels of a column with "over" between them make a ratio, and two columns with such levels a ratio of
ratios, an interaction:

    K[session=after over before, group=treated over control]
        = (K[session=after, group=treated] / K[session=before, group=treated])
        / (K[session=after, group=control] / K[session=before, group=control])

The levels of a column are compared with one another by "best", and where a claim ends to hold is "critical":

    best(pad, lowest peak_force[mass_kg=5, drop_height_cm=30])
    critical(drop_height_cm, peak_force[pad=A, mass_kg=5] < 1500)

Parsed by Lark as LALR(1), in time proportional to the text and without recursion, so that no text is slow or
deep; what a tree may be is limited besides. `bayestissue.inference.answers.meaning` works off the tree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from bayestissue.base.outline import short
from bayestissue.model.hierarchy.formulas.group_terms import as_name

if TYPE_CHECKING:
    from lark import Lark

LONGEST = 2000
DEEPEST = 40
# Each doubles what a quantity stands for.
MOST_OVER = 4
OF_ONE = ("abs", "exp", "log")
OF_MANY = ("max", "mean", "min")
COMPARISONS = ("<", "<=", ">", ">=")
CLAIMS = (*COMPARISONS, "and", "between", "not", "or")
CRITICAL = "critical"
ALLOWED = (
    "numbers, quantities such as K, K[subject=s01] or K[side=left over right], + - * / ^ ( ), "
    f"{', '.join((*OF_ONE, *OF_MANY))}, < <= > >=, between, and, or, not, critical(drop_height_cm, claim); "
    "by itself best(side, highest K)"
)

_GRAMMAR = r"""
?start: either | choice
choice: BEST "(" (NAME | QUOTED) "," EXTREME sum ")"
?either: both | either OR both -> operation
?both: negation | both AND negation -> operation
?negation: claim | NOT negation -> prefixed
?claim: sum | sum (COMPARED sum)+ -> compared | sum BETWEEN sum AND sum -> between
?sum: product | sum SIGN product -> operation
?product: sign | product TIMES sign -> operation
?sign: power | SIGN sign -> prefixed
?power: atom | atom POWER sign -> operation
?atom: "(" either ")" | NUMBER -> number | NAME "(" either ("," either)* ")" -> call | quantity
quantity: NAME ["[" level ("," level)* "]"]
level: (NAME | QUOTED) ["=" (VALUE | QUOTED) [OVER (VALUE | QUOTED)]]

BEST: "best"
EXTREME: "lowest" | "highest"
OVER: "over"
OR: "or"
AND: "and"
NOT: "not"
BETWEEN: "between"
COMPARED: "<=" | ">=" | "<" | ">" | "≤" | "≥"
SIGN: "+" | "-" | "−"
POWER: "**" | "^"
TIMES: "*" | "/"
NUMBER: /(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?/
NAME: /[^\W\d]\w*|`[^`]+`/
QUOTED: /"[^"]*"|'[^']*'/
VALUE: /[^\s,\[\]=()"']+/
%ignore /\s+/
"""
_WORDS = {
    "NUMBER": "a number",
    "NAME": "a quantity",
    "VALUE": "a level",
    "QUOTED": "a name in quotes",
    "COMPARED": "< <= > >=",
    "BETWEEN": "between",
    "SIGN": "+ -",
    "TIMES": "* /",
    "POWER": "^",
    "AND": "and",
    "OR": "or",
    "OVER": "over",
    "BEST": "best(",
    "EXTREME": "lowest or highest",
    "NOT": "not",
    "LPAR": "(",
    "RPAR": ")",
    "LSQB": "[",
    "RSQB": "]",
    "COMMA": ",",
    "EQUAL": "=",
    "$END": "the end",
}
_SAME = {"≤": "<=", "≥": ">=", "−": "-", "**": "^"}


class QuestionError(ValueError):
    """What can't be answered in a question: ``actual`` at a ``position``, and what is ``expected``."""

    def __init__(self, position: int, actual: str, expected: str, remedy: str = "") -> None:
        super().__init__(expected)
        self.position, self.actual, self.expected, self.remedy = position, short(actual, 40), expected, remedy


class Node:
    """A part of a question; ``position`` counts the characters before it.

    ``symbol`` is one of `CLAIMS`, `OF_ONE`, `OF_MANY` and + - * / ^, or empty of what has no ``operands``;
    ``column`` is that of a choice or a search.
    """

    position: int
    depth: int = 1
    symbol: str = ""
    operands: tuple[Node, ...] = ()
    column: str = ""

    @property
    def claims(self) -> bool:
        """Whether it is true or false, and not a number."""
        return self.symbol in CLAIMS

    def parts(self) -> Iterator[Node]:
        """Itself and all that it is made of, from left to right."""
        yield self
        for operand in self.operands:
            yield from operand.parts()

    def quantities(self) -> list[Quantity]:
        """The quantities in it, from left to right."""
        return [part for part in self.parts() if isinstance(part, Quantity)]

    def changed(self, change: Callable[[Node], Node]) -> Node:
        """Itself with each of its operands changed."""
        return self


@dataclass(frozen=True)
class Number(Node):
    """A finite number."""

    value: float
    position: int


@dataclass(frozen=True)
class Level:
    """``column=value``, or all levels of a column where there is no value."""

    column: str
    value: str | None
    position: int
    value_position: int

    def wrong(self, expected: str, remedy: str = "") -> QuestionError:
        """What is expected in place of its column."""
        return QuestionError(self.position, self.column, expected, remedy)

    def wrong_value(self, expected: str, remedy: str = "") -> QuestionError:
        """What is expected in place of its value."""
        return QuestionError(self.value_position, str(self.value), expected, remedy)


@dataclass(frozen=True)
class Quantity(Node):
    """A name, and at which levels it is meant."""

    name: str
    levels: tuple[Level, ...]
    position: int

    @property
    def given(self) -> dict[str, str]:
        """The level of each column that has one."""
        return {level.column: level.value for level in self.levels if level.value is not None}

    @property
    def free(self) -> list[Level]:
        """The columns of which it has all levels."""
        return [level for level in self.levels if level.value is None]

    def wrong(self, expected: str, remedy: str = "") -> QuestionError:
        """What is expected in its place."""
        return QuestionError(self.position, self.name, expected, remedy)


@dataclass(frozen=True)
class Operation(Node):
    """A function or an operator; comparisons in a row, such as 0.9 < x < 1.1, are joined by "and"."""

    # Without the defaults of what has no operands.
    symbol: str = field()
    operands: tuple[Node, ...] = field()
    position: int
    depth: int = field()
    column: str = ""

    def changed(self, change: Callable[[Node], Node]) -> Node:
        """See `Node.changed`."""
        return replace(self, operands=tuple(map(change, self.operands)))


@dataclass(frozen=True)
class Critical(Operation):
    """The greatest value of a column of the motion up to which a claim, the one operand, holds."""


@dataclass(frozen=True)
class Choice(Operation):
    """Which level of a column has the lowest, or highest, value of the one operand."""

    lowest: bool = True


def parse(text: str) -> Node:
    """The tree of a question.

    Raises:
        QuestionError: it is too long, too deep, not of the language, or a number stands where a claim
            must, or a claim where a number must.
    """
    from lark.exceptions import UnexpectedCharacters, UnexpectedToken

    if len(text) > LONGEST:
        raise QuestionError(LONGEST, f"{len(text)} characters", f"at most {LONGEST}", "Ask it in parts.")
    try:
        return _parser().parse(text)  # type: ignore[return-value]
    except UnexpectedToken as error:
        end = error.token.type == "$END"
        position = len(text) if end else int(error.token.start_pos or 0)
        raise QuestionError(
            position, "the end" if end else str(error.token), _listed(error.expected)
        ) from None
    except UnexpectedCharacters as error:
        position = int(error.pos_in_stream or 0)
        raise QuestionError(position, text[position], _listed(error.allowed)) from None


@cache
def _parser() -> Lark:
    from lark import Lark

    return Lark(_GRAMMAR, parser="lalr", transformer=_Maker())


def _listed(terminals: Any) -> str:
    words = [words for name, words in _WORDS.items() if name in set(terminals or ())]
    return f"{'one of ' if len(words) > 1 else ''}{'; '.join(words) or 'nothing more'}"


def _unquoted(token: Any) -> str:
    return str(token)[1:-1] if token[0] in "`\"'" else str(token)


def _made(symbol: str, operands: list[Node], position: int, *, claim: bool) -> Operation:
    """An operation whose operands are all claims, or all numbers."""
    symbol = _SAME.get(symbol, str(symbol))
    for operand in operands:
        if operand.claims != claim:
            actual = "a comparison" if operand.claims else "a number"
            expected = f"a {'comparison' if claim else 'number'} beside {symbol}"
            raise QuestionError(operand.position, actual, expected, "Parentheses say what belongs together.")
    depth = 1 + max(operand.depth for operand in operands)
    if depth > DEEPEST:
        actual = f"parts within parts, {depth} deep"
        raise QuestionError(position, actual, f"at most {DEEPEST}", "Ask it in parts.")
    return Operation(symbol, tuple(operands), position, depth)


def _require_ascending(low: Node, high: Node) -> None:
    """Refuse ends between which there is no number."""
    if isinstance(low, Number) and isinstance(high, Number) and low.value >= high.value:
        raise QuestionError(high.position, f"{high.value:g}", f"a number above {low.value:g}")


class _Maker:
    """What the parser calls for each rule, with its parts; a place in brackets left empty is None."""

    def number(self, parts: list[Any]) -> Node:
        (token,) = parts
        value = float(token)
        if not math.isfinite(value):
            raise QuestionError(token.start_pos, str(token), "a number below 1e308")
        return Number(value, token.start_pos)

    def level(self, parts: list[Any]) -> tuple[Level, ...]:
        column, value, _, against = parts
        name = _unquoted(column)
        if value is None:
            return (Level(name, None, column.start_pos, column.start_pos),)
        return tuple(
            Level(name, _unquoted(token), column.start_pos, token.start_pos)
            for token in (value, against)
            if token is not None
        )

    def quantity(self, parts: list[Any]) -> Node:
        name, *brackets = parts
        levels = [level for level in brackets if level is not None]
        columns = [level[0].column for level in levels]
        twice = [level[0] for index, level in enumerate(levels) if level[0].column in columns[:index]]
        if twice:
            raise twice[0].wrong("each column once")
        over = [level[1] for level in levels if len(level) > 1]
        if len(over) > MOST_OVER:
            slip = over[MOST_OVER]
            raise QuestionError(slip.value_position, f"{len(over)} times over", f"at most {MOST_OVER}")
        return self._over(name, levels)

    def _over(self, name: Any, levels: list[tuple[Level, ...]]) -> Node:
        """The quantity, or the ratio of it at the two levels of the last column that has two."""
        for last in reversed(range(len(levels))):
            if len(levels[last]) > 1:
                sides = [
                    self._over(name, [*levels[:last], (one,), *levels[last + 1 :]]) for one in levels[last]
                ]
                return _made("/", sides, levels[last][1].value_position, claim=False)
        return Quantity(as_name(_unquoted(name)), tuple(level for (level,) in levels), name.start_pos)

    def choice(self, parts: list[Any]) -> Node:
        token, column, extreme, operand = parts
        operation = _made(token, [operand], token.start_pos, claim=False)
        name, lowest = as_name(_unquoted(column)), extreme == "lowest"
        return Choice(str(token), operation.operands, column.start_pos, operation.depth, name, lowest)

    def _critical(self, name: Any, arguments: list[Any]) -> Node:
        if len(arguments) != 2 or not isinstance(arguments[0], Quantity) or arguments[0].levels:
            expected = "a column of the motion and a claim, as critical(drop_height_cm, peak_force < 1500)"
            raise QuestionError(name.start_pos, str(name), expected)
        column, claim = arguments
        if claim.symbol not in COMPARISONS:
            expected = f"one of {' '.join(COMPARISONS)} between two numbers"
            raise QuestionError(claim.position, "no single comparison", expected)
        if any(isinstance(part, Critical) for part in claim.parts()):
            raise QuestionError(claim.position, f"{CRITICAL}() within {CRITICAL}()", "a claim without one")
        return Critical(CRITICAL, (claim,), column.position, claim.depth + 1, column.name)

    def call(self, parts: list[Any]) -> Node:
        name, *arguments = parts
        if name == CRITICAL:
            return self._critical(name, arguments)
        if name not in (*OF_ONE, *OF_MANY):
            expected = f"one of {', '.join((*OF_ONE, *OF_MANY, CRITICAL))} before ("
            raise QuestionError(name.start_pos, str(name), expected)
        if name in OF_ONE and len(arguments) > 1:
            raise QuestionError(name.start_pos, f"{len(arguments)} numbers in {name}()", "one")
        return _made(name, arguments, name.start_pos, claim=False)

    def operation(self, parts: list[Any]) -> Node:
        left, token, right = parts
        return _made(token, [left, right], token.start_pos, claim=token in ("and", "or"))

    def prefixed(self, parts: list[Any]) -> Node:
        token, operand = parts
        if token == "not":  # noqa: S105 - a word of the language
            return _made("not", [operand], token.start_pos, claim=True)
        zero = Number(0.0, token.start_pos)
        return _made(token, [zero, operand], token.start_pos, claim=False)

    def compared(self, parts: list[Any]) -> Node:
        tokens, sides = parts[1::2], parts[::2]
        signs = [_SAME.get(token, str(token)) for token in tokens]
        for left, (first, last), right in zip(sides, pairwise(signs), sides[2:], strict=False):
            if first[0] == last[0]:
                _require_ascending(*((left, right) if first[0] == "<" else (right, left)))
        comparisons: list[Node] = [
            _made(token, list(pair), token.start_pos, claim=False)
            for token, pair in zip(tokens, pairwise(sides), strict=True)
        ]
        if len(comparisons) == 1:
            return comparisons[0]
        return _made("and", comparisons, tokens[0].start_pos, claim=True)

    def between(self, parts: list[Any]) -> Node:
        middle, token, low, _, high = parts
        _require_ascending(low, high)
        return _made("between", [middle, low, high], token.start_pos, claim=False)
