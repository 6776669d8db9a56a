"""Names of signals as C identifiers."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Set

__all__ = ["checked_identifier", "identifier", "identifiers", "model_identifier"]

# Of C up to C23 and of C++, which may include the headers.
_KEYWORDS = """
    alignas alignof and asm atomic bitand bitor bool catch class compl complex concept consteval constexpr constinit
    decltype delete dynamic_cast explicit export false friend imaginary mutable namespace new noexcept not nullptr
    operator or private protected public reinterpret_cast requires static_assert static_cast template this thread_local
    throw true try typeid typename typeof typeof_unqual using virtual wchar_t xor
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
# Beside the model's own file of the name: headers of the system, and devices of Windows.
_FILES = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    aux con nul prn com1 com2 com3 com4 com5 com6 com7 com8 com9 lpt1 lpt2 lpt3 lpt4 lpt5 lpt6 lpt7 lpt8 lpt9
"""
# Known to compilers without a header.
_BUILT_IN = (
    "gamma index j0 j1 jn rindex scalb significand drem finite exp10 pow10 sincos y0 y1 yn linux unix i386"
)
_MACROS = """
    BUFSIZ CHAR_BIT CHAR_MAX CHAR_MIN DECIMAL_DIG EOF EXIT_FAILURE EXIT_SUCCESS FILENAME_MAX FOPEN_MAX FP_INFINITE
    FP_NAN FP_NORMAL FP_SUBNORMAL FP_ZERO HUGE_VAL HUGE_VALF HUGE_VALL INFINITY INT_MAX INT_MIN LLONG_MAX
    LLONG_MIN LONG_MAX LONG_MIN M_1_PI M_2_PI M_E M_LN2 M_PI M_PI_2 M_SQRT2 NAN NULL RAND_MAX SCHAR_MAX SEEK_CUR
    SEEK_END SEEK_SET SHRT_MAX SHRT_MIN SIZE_MAX TMP_MAX UCHAR_MAX UINT_MAX ULONG_MAX USHRT_MAX FLT_MAX FLT_MIN
    DBL_MAX DBL_MIN DOMAIN OVERFLOW
"""
_TAKEN = frozenset(
    [
        *_KEYWORDS.split(),
        *_OTHERS.split(),
        *_FILES.split(),
        *_BUILT_IN.split(),
        *_MACROS.split(),
        *(name + end for name in _FUNCTIONS.split() for end in ("", "f", "l")),
    ]
)


def identifier(name: str) -> str:
    """A name with everything that C does not allow in it spelt out or taken out.

    Examples
    --------
    >>> identifier("plant.v[0]"), identifier("3 axes"), identifier("θ̇_2"), identifier("naïve")
    ('plant_v_0', '_3_axes', 'theta_2', 'naive')
    """
    name = "".join(_spelt(letter) for letter in unicodedata.normalize("NFKD", name))
    plain = re.sub(r"[^0-9A-Za-z_]+", "_", name).strip("_") or "_"
    return f"_{plain}" if plain[0].isdigit() else plain


def _spelt(letter: str) -> str:
    """A letter beyond ASCII by what Unicode calls it, ``theta``, or by its number; an accent is left out."""
    if letter.isascii() or unicodedata.combining(letter):
        return letter if letter.isascii() else ""
    greek = re.fullmatch(r"GREEK (?:SMALL|CAPITAL) LETTER (?:FINAL )?([A-Z]+)", unicodedata.name(letter, ""))
    if greek is None:
        return f"u{ord(letter):04x}"
    return greek[1].lower() if letter.islower() else greek[1].capitalize()


def identifiers(names: Iterable[str]) -> tuple[str, ...]:
    """One identifier per name, a number behind those that would be equal, also without regard to capitals.

    Examples
    --------
    >>> identifiers(["v[0]", "v.0", "w", "W"])
    ('v_0', 'v_0_2', 'w', 'W_2')
    """
    taken: set[str] = set()
    result: list[str] = []
    for name in names:
        base = found = identifier(name)
        number = 1
        while found.upper() in taken:  # enumerators are in capitals, and files may not tell them apart
            number += 1
            found = f"{base}_{number}"
        taken.add(found.upper())
        result.append(found)
    return tuple(result)


def model_identifier(name: str, words: Set[str] = frozenset()) -> str:
    """A name for the C code of a model that has this one.

    Parameters
    ----------
    name : str
    words : set of str
        Words of the code that the name must not be.

    Examples
    --------
    >>> model_identifier("loop 2"), model_identifier("sin"), model_identifier("pf_x"), model_identifier("u", {"u"})
    ('loop_2', 'sin_model', 'x', 'u_model')
    """
    plain = identifier(name).removeprefix("pf_").strip("_") or "diagram"
    plain = plain if plain[0].isalpha() else f"model_{plain}"
    if plain.lower() == "pf":  # pf_model is a type
        return "model_pf"
    return f"{plain}_model" if _taken(plain, words) else plain


def _taken(plain: str, words: Set[str]) -> bool:
    """Whether a name means something to C, to its library, to a file system or in the code itself."""
    return (
        plain in _TAKEN
        or plain.lower() in _TAKEN
        or plain in words
        or plain.endswith("_t")
        or plain.lower() == "pf"
    )


def checked_identifier(name: str, words: Set[str] = frozenset()) -> str:
    """The name of a model, prefix of all its C symbols.

    Parameters
    ----------
    name : str
    words : set of str
        Words of the code that the name must not be.

    Raises
    ------
    ValueError
        If it is no C identifier, a word of the language, of its library or of the code, or starts with ``pf_`` or an
        underscore.

    Examples
    --------
    >>> checked_identifier("drone")
    'drone'
    """
    if not re.fullmatch(r"[A-Za-z][0-9A-Za-z_]*", name) or name.startswith("pf_") or _taken(name, words):
        raise ValueError(
            f"name: expected a C identifier that is no word of C and does not start with 'pf_', got "
            f"{name!r}; try {model_identifier(name, words)!r}"
        )
    return name
