"""The designer in a notebook: an anywidget whose messages are answered in the kernel."""

from __future__ import annotations

import os
from collections.abc import Mapping

import anywidget
import traitlets

from ..filter import PhyFilter, SampledPhyFilter
from ..recording import Recording
from .handling import Session, handle
from .modules import sent
from .sessions import checked_session, load_session

__all__ = ["Designer"]


class Designer(anywidget.AnyWidget):
    """A live designer; :func:`phyfilter_ctl.app.designer` makes it and says what it takes.

    Its trait ``design`` is the current design as the front end has it (poles, numerator, sampling, assumptions), for
    ``observe``. Its trait ``session`` is all that the front end keeps, as a session file has it: it is saved with the
    notebook and outlives a reload of the page, and what is put there is shown.
    """

    _esm = sent("designer.js")
    _css = sent("designer.css")
    design: traitlets.Dict[str, object] = traitlets.Dict(read_only=True)
    session: traitlets.Dict[str, object] = traitlets.Dict().tag(sync=True)

    def __init__(
        self,
        filter: PhyFilter | SampledPhyFilter | None = None,
        *,
        log: Recording | str | os.PathLike[str] | None = None,
        session: str | os.PathLike[str] | None = None,
    ) -> None:
        if filter is not None and not isinstance(filter, PhyFilter | SampledPhyFilter):
            raise TypeError(f"filter: expected a PhyFilter or a SampledPhyFilter, got {filter!r}")
        recording = log if isinstance(log, Recording) or log is None else Recording.read(log)
        if session is not None and filter is not None:
            raise TypeError("expected a filter or a session to start from, got both")
        kept = None if session is None else load_session(session)
        self._session = Session(filter, log=recording, kept=kept)
        super().__init__(**({} if kept is None else {"session": kept}))
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

    @traitlets.validate("session")
    def _checked(self, proposal: Mapping[str, object]) -> object:
        """Nothing is kept that is no session, whoever sends it."""
        value = proposal["value"]
        return checked_session(value) if value else {}

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
