"""Options of a co-simulation in one dict, as tests vary them."""

from dataclasses import fields

from phyfilter_ctl.fmi import Master

NAMES = {entry.name for entry in fields(Master)}


def with_master(options):
    """What is the master's goes into one."""
    own = {name: value for name, value in options.items() if name in NAMES}
    return {name: value for name, value in options.items() if name not in NAMES} | {"master": Master(**own)}
