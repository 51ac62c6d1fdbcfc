"""How deep and how long the parts of a text may be, checked before it is parsed.

Parsers of TOML and JSON call themselves for every bracket, take quadratic time for long dotted
keys, and refuse or choke on numbers of thousands of digits. No file of this package comes near.
"""

from __future__ import annotations

import re
from typing import Final

from cassini_bayes.errors import InputError

DEEPEST: Final = 32
LONGEST_WORD: Final = 400  # characters of a number or a bare name

# Strings and comments hide what they hold; one that has no end reaches to the end of the text, so
# every byte is looked at once. JSON is written with a part of these tokens.
_TOKEN: Final = re.compile(
    r"""
      (?P<quoted> "{3}(?:[^"\\]|\\.?|"(?!""))*+(?:"{3}|\Z) | '{3}(?:[^']|'(?!''))*+(?:'{3}|\Z)
                | "(?:[^"\\\n]|\\.?)*+"? | '[^'\n]*+'? )
    | (?P<comment> \#[^\n]*+ )
    | (?P<open> [\[{] ) | (?P<close> [\]}] ) | (?P<dot> \. ) | (?P<word> [A-Za-z0-9_+-]++ )
    | (?P<other> \n | [^\s] )
    """,
    re.VERBOSE | re.DOTALL,
)


def check_bounds(text: str, where: str) -> None:
    """Refuse TOML or JSON with brackets or dotted keys too deep, or a number too long.

    Raises
    ------
    InputError
        Names the line.
    """
    depth = dots = 0
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup
        depth += (kind == "open") - (kind == "close")
        dots = dots + (kind == "dot") if kind in ("dot", "word", "quoted") else 0
        if depth > DEEPEST or dots > DEEPEST:
            expected = f"brackets and dotted keys of at most {DEEPEST} levels"
        elif kind == "word" and token.end() - token.start() > LONGEST_WORD:
            expected = f"numbers and names of at most {LONGEST_WORD} characters"
        else:
            continue
        line = text.count("\n", 0, token.start()) + 1
        raise InputError(f"{where}: line {line}", expected, "more", "check that line")
