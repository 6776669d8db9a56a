"""Words that options choose between, for the rooms that take them and for the command line, which imports no room."""

from typing import Literal

__all__ = ["Family", "Form", "Method", "TimeUnit"]

Family = Literal["binomial", "butterworth", "bessel", "itae"]
Form = Literal["lowpass", "general"]
Method = Literal["exact", "matched", "euler", "tustin"]
TimeUnit = Literal["s", "ms", "us", "ns"]
