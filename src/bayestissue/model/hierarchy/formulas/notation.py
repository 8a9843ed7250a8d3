"""A formula's text becomes the terms that formulae makes of it, with every character of the text used.

Tokens, the precedence of powers and of a minus before them, and the names of terms are of this module; the
grammar beside them and the algebra of terms are formulae's. Its own scanner and parser stop without a word at
the first token that they do not understand, and its names of terms lose parentheses, so that
``{(age - 30)**2}`` would be evaluated as age less 900.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Iterator
from typing import Any, NoReturn

from formulae import resolver
from formulae.expr import Binary, Call, Grouping, Literal, QuotedName, Unary, Variable
from formulae.parser import ParseError, Parser
from formulae.scanner import Scanner
from formulae.terms.call import Call as CallOfTerm
from formulae.terms.call_resolver import CallResolver
from formulae.terms.terms import GroupSpecificTerm, Model, Term
from formulae.terms.variable import Variable as VariableOfTerm
from formulae.token import Token

from bayestissue.model.hierarchy.formulas.group_terms import quoted

# More are a slip: a * b * c * ... of ten columns has 1023.
MOST_TERMS = 256
# Characters of a formula in a message.
SHOWN = 40
_TOKENS = re.compile(
    r"(?P<NUMBER>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<IDENTIFIER>[^\W\d][\w.]*)"
    r"|(?P<BQNAME>`[^`]+`)"
    r"|(?P<STRING>\"[^\"]*\"|'[^']*')"
    r"|(?P<SYMBOL>\*\*|==|!=|<=|>=|[-+*/:|(){},<>])"
)
_SYMBOLS = {
    symbol: Scanner(symbol).scan(add_intercept=False)[0].kind
    for symbol in [
        "(",
        ")",
        "{",
        "}",
        ",",
        "+",
        "-",
        "*",
        "**",
        "/",
        ":",
        "|",
        "==",
        "!=",
        "<",
        "<=",
        ">",
        ">=",
    ]
}
_KNOWN = ("C", "I", "log", "sqrt")
_COMPARED = ("==", "!=", "<", "<=", ">", ">=")
# Operators by the number of their operands and their symbol, those first that bind least.
_OPERATORS = ((2, _COMPARED), (2, "+-"), (2, "*/"), (1, "+-"), (2, ("**",)))
_BINDING = {(n, symbol): binds for binds, (n, symbols) in enumerate(_OPERATORS) for symbol in symbols}


class NotationError(ValueError):
    """Why a formula can't be read, as a clause that names the place."""


def described(formula: str) -> Any:
    """The terms of a formula, with an intercept, as formulae's ``Model``.

    Raises:
        NotationError: a character of it would not be used, or stands for nothing.
        RecursionError: parentheses are too deep within one another.
    """
    model = _terms(parsed(formula))
    names = [term.name for term in model.common_terms]
    if twice := [name for name in names if names.count(name) > 1]:
        raise NotationError(f"two different terms would be called {twice[0]}")
    return model


def parsed(formula: str) -> Any:
    """The tree of a formula and of an intercept before it, as formulae's ``Parser`` makes it.

    Raises:
        NotationError: as of `described`.
    """
    tokens = [Token("NUMBER", "1", 1), Token("PLUS", "+"), *_tokens(formula), Token("EOF", "")]
    parser = _Parser(tokens)
    try:
        tree = parser.parse()
    except ParseError:
        _refuse(formula, parser.peek())
    if not parser.at_end():
        _refuse(formula, parser.peek())
    if isinstance(tree, Binary) and tree.operator.kind == "PIPE":
        raise NotationError("a group term stands in parentheses, as (1|subject)")
    _check(tree)
    return tree


def parentheses(tree: Any) -> Iterator[Any]:
    """What each parenthesis with a bar in it asks for, as a ``Model`` each."""
    for part in _parts(tree):
        if isinstance(part, Binary) and part.operator.kind == "PIPE":
            yield _terms(part)


def text_of(term: Any) -> str:
    """A term of covariates as a formula has it: ``side:`left foot```."""
    return ":".join(
        str(part.name) if isinstance(part, CallOfTerm) else quoted([part.name]) for part in term.components
    )


def _tokens(formula: str) -> Iterator[Token]:
    position = 0
    while position < len(formula):
        if formula[position].isspace():
            position += 1
            continue
        match = _TOKENS.match(formula, position)
        if match is None:
            _refuse(formula, position)
        text, kind = match[0], str(match.lastgroup)
        token = Token(_SYMBOLS.get(text, kind), text, _value(kind, text))
        token.position = position
        yield token
        position = match.end()


def _value(kind: str, text: str) -> float | str | None:
    if kind != "NUMBER":
        return text[1:-1] if kind == "STRING" else None
    value = float(text)  # and no whole number, whose powers have no bound
    if math.isinf(value):
        raise NotationError(f"the number {text[:SHOWN]} is beyond 1e308")
    return value


def _refuse(formula: str, unusable: Any) -> NoReturn:
    """What can't be used, a position or a token: the last one if the formula ends too early."""
    position = unusable if isinstance(unusable, int) else getattr(unusable, "position", len(formula))
    before = formula[:position].rstrip()
    if not formula[position:].strip():
        raise NotationError(f"it breaks off after {before[-SHOWN:]!r}")
    what = formula[position : position + SHOWN]
    after = f", after {before[-SHOWN:]!r}," if before else ""
    raise NotationError(f"what begins at character {position + 1}{after} can't be read there: {what!r}")


class _Parser(Parser):
    """Formulae's, with powers that bind as in arithmetic: ``-x**2`` is -(x²), ``2**3**2`` is 2⁹."""

    def multiple_interaction(self) -> Any:
        return self.unary()

    def call(self) -> Any:
        left = super().call()
        if not self.match("STAR_STAR"):
            return left
        power = self.previous()
        return Binary(left, power, self.unary())


def _parts(tree: Any) -> Iterator[Any]:
    """A tree and its parts outside calls, from left to right."""
    yield tree
    for part in _operands(tree):
        yield from _parts(part)


def _operands(tree: Any) -> tuple[Any, ...]:
    if isinstance(tree, Binary):
        return tree.left, tree.right
    if isinstance(tree, Unary):
        return (tree.right,)
    return (tree.expression,) if isinstance(tree, Grouping) else ()


def _bare(tree: Any) -> Any:
    """Without parentheses around it."""
    return _bare(tree.expression) if isinstance(tree, Grouping) else tree


def _check(tree: Any, within: str = "") -> None:
    """Refuse what formulae passes over, outside calls; ``within`` the operator that it is an operand of."""
    if isinstance(tree, Literal) and isinstance(tree.value, str):
        raise NotationError(f"{tree.lexeme} is no term: a column stands without quotes, or in backquotes")
    if isinstance(tree, Literal) and (tree.value not in (0, 1) or within not in ("", "|")):
        raise NotationError(f"{_number(tree.value)} is no term: arithmetic stands in braces, as {{2 * age}}")
    if isinstance(tree, Call):
        _check_call(tree)
    if isinstance(tree, Unary) and tree.operator.kind == "MINUS" and not isinstance(tree.right, Literal):
        raise NotationError("a minus takes out a term that stands before it")
    symbol, operands = within, _operands(tree)
    if isinstance(tree, Binary):
        symbol = within if tree.operator.lexeme in "+-" else tree.operator.lexeme
        _check_operation(tree, within)
        operands = operands[:1] if symbol == "**" else operands
    for part in operands:
        _check(part, symbol)


def _check_operation(tree: Any, within: str) -> None:
    symbol, left, right = tree.operator.lexeme, _bare(tree.left), _bare(tree.right)
    if symbol in _COMPARED:
        raise NotationError(f"a comparison stands in braces, as {{age {symbol} 30}}")
    if symbol == "|" and within:
        raise NotationError(f"a group term, as (1|subject), is no part of a term with {within}")
    power = right.value if isinstance(right, Literal) else None
    if symbol == "**" and not (isinstance(left, Binary) and power in range(1, 10)):
        raise NotationError("** of numbers stands in braces, as {age**2}, and of terms is as in (a + b)**2")
    if symbol in ("*", ":", "/") and left == right:
        raise NotationError(f"{symbol} between a term and itself adds nothing; a square is as {{age**2}}")


def _check_call(call: Any) -> None:
    """Refuse what is no arithmetic in a call, and arguments beside the one that the known functions have."""
    if not isinstance(call.callee, Variable):
        raise NotationError("a parenthesis stands behind what is no function")
    name = call.callee.name.lexeme
    if name in _KNOWN and len(call.args) != 1:
        raise NotationError(f"{name}() is of one column or of one piece of arithmetic")
    waiting = list(call.args)
    while waiting:
        part = waiting.pop()
        if isinstance(part, Call):
            _check_call(part)
        if isinstance(part, Binary) and (2, part.operator.lexeme) not in _BINDING:
            raise NotationError(f"{part.operator.lexeme} is no arithmetic")
        waiting += _operands(part)


def _terms(tree: Any) -> Any:
    terms = tree.accept(_Resolver(tree))
    return terms if isinstance(terms, Model) else Model(terms)


class _Resolver(resolver.Resolver):
    """Formulae's, with a bound on the number of terms, and nothing taken out that is not there."""

    def visitBinaryExpr(self, expr: Any) -> Any:  # noqa: N802 - formulae's name
        symbol = expr.operator.lexeme
        left = expr.left.accept(self)
        count = len(_terms_in(left))
        if symbol == "**":
            power = int(_bare(expr.right).value)
            _bound(sum(math.comb(count, size) for size in range(1, power + 1)))
            return Model(*_terms_in(left)) ** Term(VariableOfTerm(power))
        right = expr.right.accept(self)
        if symbol != "+":
            _bound(count * len(_terms_in(right)))
        if symbol == "-":
            left = Model(*_terms_in(left))
            if any(isinstance(t, Term | GroupSpecificTerm) and t not in left.terms for t in _terms_in(right)):
                raise NotationError("a minus takes out a term that stands before it")
        return _ALGEBRA[symbol](left, right)

    def visitCallExpr(self, expr: Any) -> Any:  # noqa: N802
        call = CallOfTerm(CallResolver(expr).resolve())
        # Formulae's own loses parentheses and quotes.
        call.name = _text(expr)
        return Term(call)


_ALGEBRA = {
    "+": operator.add,
    "-": operator.sub,
    ":": operator.matmul,
    "*": operator.mul,
    "/": operator.truediv,
    "|": operator.or_,
}


def _terms_in(terms: Any) -> list[Any]:
    return terms.terms if isinstance(terms, Model) else [terms]


def _bound(count: int) -> None:
    if count > MOST_TERMS:
        raise NotationError(f"it has {count} terms, and a design has {MOST_TERMS} at most")


def _text(part: Any, least: int = 0) -> str:
    """Arithmetic as it is read again, in parentheses if it binds less than ``least``."""
    match part:
        case Grouping():
            return _text(part.expression, least)
        case Call():
            return f"{part.callee.name.lexeme}({', '.join(map(_text, part.args))})"
        case Variable():
            return quoted([part.name.lexeme])
        case QuotedName():
            return quoted([part.expression.lexeme[1:-1]])
        case Literal():
            return str(part.lexeme or _number(part.value))
    symbol, power = part.operator.lexeme, part.operator.lexeme == "**"
    binds = _BINDING[len(_operands(part)), symbol]
    if isinstance(part, Unary):
        text = f"{symbol}{_text(part.right, binds)}"
    else:
        right = _text(part.right, _BINDING[1, "-"] if power else binds + 1)
        text = f"{_text(part.left, binds + power)} {symbol} {right}"
    return f"({text})" if binds < least else text


def _number(value: float) -> str:
    return repr(float(value)).removesuffix(".0")
