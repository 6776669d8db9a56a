"""Names of signals as C identifiers."""

from __future__ import annotations

import re
from collections.abc import Iterable

__all__ = ["checked_identifier", "identifier", "identifiers", "model_identifier"]

_KEYWORDS = """
    auto break case char const continue default do double else enum extern float for goto if inline int long main
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
"""
# Of <math.h>, <string.h>, <stdio.h>, <stdlib.h>: a type of that name would not compile beside them. With f and l.
_FUNCTIONS = """
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs fdim floor fma fmax
    fmin fmod frexp hypot ilogb ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround modf nan nearbyint
    nextafter nexttoward pow remainder remquo rint round scalbln scalbn sin sinh sqrt tan tanh tgamma trunc
"""
_OTHERS = """
    abort abs atexit atof atoi atol bsearch calloc clearerr div exit fclose feof ferror fflush fgetc fgetpos fgets fopen
    fprintf fputc fputs fread free freopen fscanf fseek fsetpos ftell fwrite getc getchar getenv gets labs ldiv malloc
    memchr memcmp memcpy memmove memset perror printf putc putchar puts qsort rand realloc remove rename rewind scanf
    setbuf setvbuf sprintf srand sscanf stderr stdin stdout strcat strchr strcmp strcpy strlen strncat strncmp strncpy
    strstr strtod strtok strtol strtoul system time tmpfile tmpnam ungetc vprintf double_t float_t signal
"""
_TAKEN = frozenset(
    [
        *_KEYWORDS.split(),
        *_OTHERS.split(),
        *(name + end for name in _FUNCTIONS.split() for end in ("", "f", "l")),
    ]
)


def identifier(name: str) -> str:
    """A name with everything that C does not allow in it taken out.

    Examples
    --------
    >>> identifier("plant.v[0]"), identifier("3 axes")
    ('plant_v_0', '_3_axes')
    """
    plain = re.sub(r"[^0-9A-Za-z_]+", "_", name).strip("_") or "_"
    return f"_{plain}" if plain[0].isdigit() else plain


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """One identifier per name, a number behind those that would be equal.

    Examples
    --------
    >>> identifiers(["v[0]", "v.0", "w"])
    ('v_0', 'v_0_2', 'w')
    """
    taken: set[str] = set()
    result: list[str] = []
    for name in names:
        base = found = identifier(name)
        number = 1
        while found in taken:
            number += 1
            found = f"{base}_{number}"
        taken.add(found)
        result.append(found)
    return tuple(result)


def model_identifier(name: str) -> str:
    """A name for the C code of a model that has this one.

    Examples
    --------
    >>> model_identifier("loop 2"), model_identifier("sin"), model_identifier("pf_x")
    ('loop_2', 'sin_model', 'x')
    """
    plain = identifier(name).removeprefix("pf_").strip("_") or "diagram"
    plain = plain if plain[0].isalpha() else f"model_{plain}"
    return f"{plain}_model" if plain in _TAKEN else plain


def checked_identifier(name: str) -> str:
    """The name of a model, prefix of all its C symbols.

    Raises
    ------
    ValueError
        If it is no C identifier, a word of the language or of its library, or starts with ``pf_`` or an underscore.

    Examples
    --------
    >>> checked_identifier("drone")
    'drone'
    """
    if not re.fullmatch(r"[A-Za-z][0-9A-Za-z_]*", name) or name in _TAKEN or name.startswith("pf_"):
        raise ValueError(
            f"name: expected a C identifier that is no word of C and does not start with 'pf_', got "
            f"{name!r}; try {model_identifier(name)!r}"
        )
    return name
