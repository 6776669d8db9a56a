"""One Python function between the designer's front end and the library: a message in, a reply out.

Messages and replies are what JSON holds: complex numbers [re, im], SI units, rad/s, null for what is not finite. Every
request has ``id``, ``op`` and the fields of that op; every reply has ``id``, ``op``, ``ok`` and either the answer or an
``error`` of one sentence and, where a field is to blame, ``where``.

========  ==========================================  ===============================================================
op        request                                     reply
========  ==========================================  ===============================================================
hello                                                 version, design, families, log, session, waiting, can
design    design                                      filter, frequency, step, numbers, stable_sampled, messages
family    family, order, cutoff, damping, type, band  design
log       name, text                                  log
upload    name, size, at, data                        received, size
preview   time, time_unit                             file, columns, time, roles, messages
import    time, time_unit, x, label, g, f_theta,      log, messages
          inertia, unit_x, unit_f, step
example                                               log, messages
measured  channel                                     dt, slope, noise, messages
forget                                                log (null)
loop      design                                      omega, L, S, T, note, stable, band, message
locus     design, over                                at, branches, now, limits, message
responses design                                      t, command, disturbance, noise, noise_sd, dt, message
estimate  design, channel, window                     t, f_hat, f_theta, label, rmse, rmse_model, wiener, over,
                                                      pending, messages
learn     order, form                                 job
job       job                                         state, curve, message, design
cancel    job                                         state, curve, message
python    design                                      text
save      design, name                                name, mime, base64, messages
open      name, text                                  design, messages
exports   design, channels                            name, exports, channels
export    design, kind, channels, name                name, mime, base64, messages
compare   designs                                     compared
report    design, format, name                        name, mime, base64
meet      design, trade, form, delay_margin, ratios   job
front     job                                         state, message, done, certain, front
unmeet    job                                         state, message, done, certain, front
session   text                                        session
========  ==========================================  ===============================================================
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.linalg import LinAlgError
from threadpoolctl import ThreadpoolController

from ..design.learning import Form
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from ..recording import Recording
from . import answers, exports, importing, logs, loop_views, sessions
from .checking import Fields, MessageError
from .designs import (
    FAMILIES,
    HIGHEST_ORDER,
    MOST_CHANNELS,
    Design,
    design_of_family,
    read_design,
    read_designs,
)
from .inbox import Inbox
from .jobs import LearningJob
from .meeting import Meetings
from .python_text import python_text
from .views import Views

__all__ = ["Session", "handle"]

_LATEST = 1e12  # s; times may count from 1970
_LARGEST_FILE = 200_000
_MOST_COMPARED = 12
_WISHES = ("design", "trade", "form", "delay_margin", "ratios")
_LONGEST_ERROR = 600
_WAIT_FOR_CANCEL = 0.5  # s
_LARGEST_ID = 2**53  # integers that JavaScript holds

Reply = dict[str, object]


class Session:
    """What one front end has open: the current design, a log, a learning job. Sessions share nothing.

    Parameters
    ----------
    start : PhyFilter or SampledPhyFilter, optional (a bank is refused)
        Where the design begins; None means two poles at -20 rad/s.
    log : Recording, optional
        Open from the start.
    kept : mapping, optional
        A session to go on with instead, as :func:`phyfilter_ctl.app.sessions.read_session` gives it.
    waiting : Path, optional
        A file of this machine that the user is to be asked about: which of its columns are what.

    Raises
    ------
    ValueError
        If ``start`` is of another size than a designer shows.

    Examples
    --------
    >>> session = Session()
    >>> reply = handle(session, {"id": 1, "op": "hello"})
    >>> reply["ok"], reply["design"]["poles"]
    (True, [[-20.0, 0.0], [-20.0, 0.0]])
    """

    def __init__(
        self,
        start: PhyFilter | FilterBank | SampledPhyFilter | None = None,
        *,
        log: Recording | None = None,
        kept: Mapping[str, object] | None = None,
        waiting: Path | None = None,
    ) -> None:
        self.inbox: Inbox = Inbox(waiting)
        self.views: Views = Views()
        self._lock = threading.Lock()
        self._design = Design() if start is None else Design().with_filter(start)
        if kept is not None:
            self._design = read_design(Fields.of(kept))
        self._log = log
        self._began = self._design, log, kept
        self._job: LearningJob | None = None
        self._jobs = 0
        self.meetings: Meetings = Meetings()

    @property
    def design(self) -> Design:
        """The design last asked about."""
        with self._lock:
            return self._design

    @property
    def kept(self) -> Mapping[str, object] | None:
        """The session that it went on with at first."""
        return self._began[2]

    def again(self) -> Session:
        """Another session that starts where this one started.

        Returns
        -------
        Session
        """
        design, log, kept = self._began
        other = Session(log=log, kept=kept, waiting=self.inbox.named)
        other._design, other._began = design, self._began
        return other

    @property
    def filter(self) -> PhyFilter:
        """Its filter."""
        return self.design.filter

    @property
    def log(self) -> Recording | None:
        """The open log."""
        with self._lock:
            return self._log

    @property
    def job(self) -> LearningJob | None:
        """The last learning job."""
        with self._lock:
            return self._job

    def close(self) -> None:
        """End the learning job and the search for filters, if they run, and let go of files."""
        self.inbox.close()
        self.meetings.close()
        job = self.job
        if job is not None:
            job.cancel(_WAIT_FOR_CANCEL)

    # -- changes, all under the lock ------------------------------------------------------------------------------

    def set_design(self, design: Design) -> None:
        """Make this the current design.

        Parameters
        ----------
        design : Design
        """
        with self._lock:
            self._design = design

    def set_log(self, log: Recording | None) -> None:
        """Open another log, or none; a job on the old one ends.

        Parameters
        ----------
        log : Recording or None
        """
        with self._lock:
            self._log, job = log, self._job
        if job is not None:
            job.cancel()

    def begin(self, order: int, form: Form) -> LearningJob:
        """Start learning from the open log.

        Parameters
        ----------
        order : int
        form : {"lowpass", "general"}

        Raises
        ------
        ValueError
            If there is no log with a label, or a job still runs.
        """
        with self._lock:
            if self._log is None:
                raise ValueError("no log is open: drop a CSV file with a label first")
            if self._log.label is None:
                raise ValueError(
                    "the log has no label, the true f to learn from: expected columns label_<x> (or ax for vx)"
                )
            if self._job is not None and self._job.running:
                raise ValueError(f"job {self._job.number} still learns: cancel it or wait for its end")
            self._jobs += 1
            self._job = LearningJob(self._jobs, self._log, order, form=form, like=self._design)
            self._job.start()
            return self._job


def handle(session: Session, message: Mapping[str, object]) -> Reply:
    """Answer one message of the front end. Never raises: what is wrong is said in the reply.

    Parameters
    ----------
    session : Session
    message : mapping
        As the JSON reader gives it.

    Returns
    -------
    dict
        Ready for ``json.dumps(..., allow_nan=False)``.

    Examples
    --------
    >>> session = Session()
    >>> reply = handle(session, {"id": 2, "op": "family", "family": "binomial", "order": 2, "cutoff": 20.0})
    >>> reply["ok"], len(reply["design"]["poles"])
    (True, 2)
    >>> handle(session, {"id": 3, "op": "family", "family": "cauer", "order": 2, "cutoff": 20.0})["where"]
    'family'
    """
    head: Reply = {"id": None, "op": None}
    try:
        fields = Fields.of(message)
        head["id"] = fields.integer("id", 0, _LARGEST_ID)
        op = fields.choice("op", tuple(_OPERATIONS))
        head["op"] = op
        work, known = _OPERATIONS[op]
        fields.only("id", "op", *known)
        # Two BLAS threads are several times slower on matrices of this size. numpy's flags are the thread's own.
        with _blas().limit(limits=1, user_api="blas"), np.errstate(all="ignore"):
            return head | {"ok": True} | work(session, fields)
    except MessageError as error:
        return head | {"ok": False, "error": _sentence(error), "where": error.where}
    except Exception as error:
        if isinstance(error, ValueError | TypeError) and not isinstance(error, LinAlgError):
            return head | {"ok": False, "error": _sentence(error)}
        # Whatever else: its text may name files of this machine.
        text = f"the computation failed ({type(error).__name__}): change the design a little and try again"
        return head | {"ok": False, "error": text}


# -- operations -------------------------------------------------------------------------------------------------


def _hello(session: Session, fields: Fields) -> Reply:
    log = session.log
    return {
        "version": _version(),
        "design": session.design.as_json(),
        "families": list(FAMILIES),
        "log": None if log is None else logs.summary(log),
        "session": session.kept,
        "waiting": session.inbox.waiting,
        "can": exports.abilities(),
    }


def _design(session: Session, fields: Fields) -> Reply:
    design = read_design(fields)
    session.set_design(design)
    return answers.answer(design)


def _loop(session: Session, fields: Fields) -> Reply:
    return loop_views.loop(read_design(fields))


def _locus(session: Session, fields: Fields) -> Reply:
    return loop_views.locus(read_design(fields), fields.choice("over", ("ratio", "bandwidth")))


def _responses(session: Session, fields: Fields) -> Reply:
    return loop_views.responses(read_design(fields))


def _family(session: Session, fields: Fields) -> Reply:
    return {"design": design_of_family(fields, session.design).as_json()}


def _forget(session: Session, fields: Fields) -> Reply:
    session.set_log(None)
    return {"log": None}


def _estimate(session: Session, fields: Fields) -> Reply:
    design = read_design(fields)
    channel = fields.integer("channel", 0, MOST_CHANNELS - 1) if "channel" in fields else 0
    log, job = session.log, session.job
    if log is None:
        raise ValueError("no log is open: drop a CSV file first")
    wiener = job.wiener if job is not None and job.log is log else None
    window = fields.numbers("window", 2, 2, size=_LATEST) if "window" in fields else None
    return logs.estimate(log, design, channel, wiener, window=window, views=session.views)


def _learn(session: Session, fields: Fields) -> Reply:
    order = fields.integer("order", 1, HIGHEST_ORDER)
    form = fields.choice("form", ("lowpass", "general")) if "form" in fields else "lowpass"
    return {"job": session.begin(order, cast(Form, form)).number}


def _job(session: Session, fields: Fields) -> Reply:
    return _asked(session, fields).snapshot()


def _cancel(session: Session, fields: Fields) -> Reply:
    job = _asked(session, fields)
    job.cancel(_WAIT_FOR_CANCEL)
    return job.snapshot()


def _python(session: Session, fields: Fields) -> Reply:
    return {"text": python_text(read_design(fields))}


def _save(session: Session, fields: Fields) -> Reply:
    design = exports.with_log(read_design(fields), session.log, None)
    return exports.saved(design, _name(fields))


def _open(session: Session, fields: Fields) -> Reply:
    if "name" in fields:
        fields.text("name")
    design, messages = exports.opened(fields.text("text", _LARGEST_FILE), session.design)
    return {"design": design.as_json(), "messages": messages}


def _exports(session: Session, fields: Fields) -> Reply:
    return exports.exchange(*_handed_over(session, fields))


def _session(session: Session, fields: Fields) -> Reply:
    return {"session": sessions.read_session(fields.text("text", sessions.LARGEST_SESSION))}


def _export(session: Session, fields: Fields) -> Reply:
    design, channels = _handed_over(session, fields)
    return exports.export(design, fields.choice("kind", exports.KINDS), channels, _name(fields))


def _report(session: Session, fields: Fields) -> Reply:
    from .design_report import report  # matplotlib is slow to import

    format = "pdf" if fields.choice("format", ("html", "pdf")) == "pdf" else "html"
    return report(read_design(fields), format, _name(fields))


def _compare(session: Session, fields: Fields) -> Reply:
    return {"compared": [answers.figures(design) for design in read_designs(fields, _MOST_COMPARED)]}


_OPERATIONS: Mapping[str, tuple[Callable[[Session, Fields], Reply], tuple[str, ...]]] = {
    "hello": (_hello, ()),
    "design": (_design, ("design",)),
    "loop": (_loop, ("design",)),
    "locus": (_locus, ("design", "over")),
    "responses": (_responses, ("design",)),
    "family": (_family, ("family", "order", "cutoff", "damping", "type", "band")),
    "upload": (importing.upload, ("name", "size", "at", "data")),
    "preview": (importing.preview_, ("time", "time_unit")),
    "import": (importing.import_, importing.ROLES),
    "example": (importing.example, ()),
    "measured": (importing.measured, ("channel",)),
    "forget": (_forget, ()),
    "estimate": (_estimate, ("design", "channel", "window")),
    "learn": (_learn, ("order", "form")),
    "job": (_job, ("job",)),
    "cancel": (_cancel, ("job",)),
    "python": (_python, ("design",)),
    "save": (_save, ("design", "name")),
    "open": (_open, ("name", "text")),
    "exports": (_exports, ("design", "channels")),
    "export": (_export, ("design", "kind", "channels", "name")),
    "compare": (_compare, ("designs",)),
    "report": (_report, ("design", "format", "name")),
    "meet": (lambda session, fields: session.meetings.begin(fields), _WISHES),
    "front": (lambda session, fields: session.meetings.look(fields), ("job",)),
    "unmeet": (lambda session, fields: session.meetings.look(fields, end=True), ("job",)),
    "session": (_session, ("text",)),
}


# -- inside -----------------------------------------------------------------------------------------------------


def _handed_over(session: Session, fields: Fields) -> tuple[Design, int]:
    """The design with what it and the open log say of the signals, and its number of channels."""
    asked = fields.integer("channels", 1, MOST_CHANNELS) if "channels" in fields else None
    design = exports.with_log(read_design(fields), session.log, asked)
    return design, exports.channels_of(design, asked)


def _name(fields: Fields) -> str:
    return fields.text("name") if "name" in fields else ""


def _asked(session: Session, fields: Fields) -> LearningJob:
    number = fields.integer("job", 0, _LARGEST_ID)
    job = session.job
    if job is None or job.number != number:
        raise fields.error("job", f"there is no job {number}; start one with op learn")
    return job


def _sentence(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= _LONGEST_ERROR else text[:_LONGEST_ERROR] + " ..."


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    """Found once: looking for the libraries takes longer than a design."""
    return ThreadpoolController()


def _version() -> str:
    from .. import __version__  # at the call: the root imports the rooms

    return __version__
