"""The designer in a notebook: an anywidget whose messages are answered in the kernel."""

from __future__ import annotations

import os

import anywidget
import traitlets

from ..filter import PhyFilter, SampledPhyFilter
from ..recording import Recording
from .handle import Session, handle
from .modules import sent

__all__ = ["Designer"]


class Designer(anywidget.AnyWidget):
    """A live designer; :func:`phyfilter_ctl.app.designer` makes it and says what it takes.

    Its trait ``design`` is the current design as the front end has it (poles, numerator, sampling, assumptions), for
    ``observe``.
    """

    _esm = sent("designer.js")
    _css = sent("designer.css")
    design: traitlets.Dict[str, object] = traitlets.Dict(read_only=True)

    def __init__(
        self,
        filter: PhyFilter | SampledPhyFilter | None = None,
        *,
        log: Recording | str | os.PathLike[str] | None = None,
    ) -> None:
        if filter is not None and not isinstance(filter, PhyFilter | SampledPhyFilter):
            raise TypeError(f"filter: expected a PhyFilter or a SampledPhyFilter, got {filter!r}")
        recording = log if isinstance(log, Recording) or log is None else Recording.from_csv(log)
        self._session = Session(filter, log=recording)
        super().__init__()
        self.set_trait("design", self._session.design.as_json())
        self.on_msg(self._answer)

    @property
    def filter(self) -> PhyFilter:
        """The filter that is designed now."""
        return self._session.filter

    @property
    def sampled(self) -> SampledPhyFilter:
        """The same as it runs, sampled as the designer shows.

        Raises
        ------
        ValueError
            If forward Euler diverges.
        """
        return self._session.design.sampled

    def close(self) -> None:
        """Take the designer off the page and end its learning job."""
        # Widgets that were never opened are closed too, by their own end.
        session: Session | None = self.__dict__.get("_session")
        if session is not None:
            session.close()
        super().close()

    def _answer(self, widget: anywidget.AnyWidget, message: object, buffers: list[memoryview]) -> None:
        known = message if isinstance(message, dict) else {}
        self.send(handle(self._session, known))
        self.set_trait("design", self._session.design.as_json())
