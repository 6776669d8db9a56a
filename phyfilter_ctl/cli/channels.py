"""Files with a filter of its own for each channel: the channels by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..analysis.frequency import FilterResponseList, frequency_response
from ..filter import FilterBank, PhyFilter, SampledPhyFilter

__all__ = ["by_channel", "figures_below", "responses", "text_of"]

Filter = PhyFilter | SampledPhyFilter


def by_channel(system: Filter | FilterBank, names: Sequence[str]) -> dict[str, Filter]:
    """Each filter by the name of its channel; one that serves all channels without a name."""
    if isinstance(system, PhyFilter) or (isinstance(system, SampledPhyFilter) and len(system.filters) == 1):
        return {"": system}
    filters = system.by_channel if isinstance(system, SampledPhyFilter) else system
    if len(names) != len(filters):  # not noted in the file, or of x where there is an E
        names = [f"channel {i}" for i in range(len(filters))]
    return dict(zip(names, filters, strict=True))


def responses(channels: Mapping[str, Filter]) -> FilterResponseList:
    """The frequency response of each, over one axis."""
    found = zip(channels, frequency_response(list(channels.values())), strict=True)
    return FilterResponseList(replace(entry, name=name) for name, entry in found)


def figures_below(figures: Mapping[str, dict[str, object]]) -> dict[str, object]:
    """What the JSON holds: the figures themselves, or those of each channel below "channels"."""
    return figures.get("", {"channels": dict(figures)})


def text_of(texts: Mapping[str, str]) -> str:
    """What is printed: each channel below its name."""
    return "\n\n".join(f"{name}:\n{text}" if name else text for name, text in texts.items())
