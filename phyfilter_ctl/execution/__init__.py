"""Independent jobs, one executor for all: in this process, over the cores, or over a Dask cluster.

``executor`` hands jobs out and gives their answers in order; ``processes`` are the workers of this machine, ``cluster``
those of a Dask scheduler; ``checkpoint`` keeps what is done on disk; ``progress`` shows it.
"""

from .checkpoint import Checkpoint
from .executor import Executor, Kind
from .progress import Report, progress, silent

__all__ = ["Checkpoint", "Executor", "Kind", "Report", "progress", "silent"]
