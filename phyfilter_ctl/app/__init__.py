"""The interactive designer: one front end, one Python function from message to reply, two hosts."""

from __future__ import annotations

import os
from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from ..filter import PhyFilter, SampledPhyFilter
from ..recording import Recording

if TYPE_CHECKING:
    from .widget import Designer

__all__ = ["designer"]


def designer(
    filter: PhyFilter | SampledPhyFilter | None = None,
    *,
    log: Recording | str | os.PathLike[str] | None = None,
    session: str | os.PathLike[str] | None = None,
) -> Designer:
    """Design a filter interactively, in a notebook.

    Parameters
    ----------
    filter : PhyFilter or SampledPhyFilter, optional
        Where the design begins; None means two poles at -20 rad/s. A sampled one brings its step and method.
    log : Recording or path, optional
        A recording to try it on; a path is read by :meth:`Recording.read`.
    session : path, optional
        A session to go on with, as the designer saved it; instead of a filter.

    Returns
    -------
    Designer
        Show it as the last line of a cell; ``.filter`` is the current design at any time.

    Raises
    ------
    ImportError
        Without the extra ``notebook``.
    TypeError
        If ``filter`` is something else, or there is a session beside it.
    ValueError
        If it is of another size than a designer shows (order 1 to 8, poles of 1e-3 to 1e5 rad/s), or the recording or
        the session is broken.
    OSError
        If the recording or the session cannot be read.

    Notes
    -----
    While the kernel works, the designer goes on with what the browser can compute; Python's answers follow. The same
    designer opens as a page of its own with ``phyfilter-ctl app``.
    """
    try:
        from .widget import Designer
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("anywidget", "ipywidgets", "traitlets"):
            raise
        raise ImportError(
            f"the designer in a notebook needs {error.name}, which is not installed: "
            "pip install 'phyfilter-ctl[notebook]'"
        ) from error
    return Designer(filter, log=log, session=session)


if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
