"""Jobs over cores and machines, as the room of executors has them: names for those who study."""

from ..execution import Checkpoint, Executor, Kind, Report, progress, silent

__all__ = ["Checkpoint", "Executor", "Kind", "Report", "progress", "silent"]
