"""A study of one's own system: numbers with units, flights over seeds, tuning at equal margin, statistics, output.

===========================  ===================================================================================
numbers from a TOML file     :func:`parameter_file`, :func:`read_parameters`: typed, each with its unit and reason
flights over seeds           :func:`flight_times`, :func:`unit_noise`, then ``simulate_batch``, :func:`flight_signals`
tuning at equal margin       :func:`least_error` of what :func:`fastest` finds; :func:`tuned_text`, :func:`read_tuned`
methods by cases by seeds    :func:`score_methods`: medians with intervals, reductions flight by flight
over cores and machines      :class:`Executor`; :class:`Checkpoint` to go on where a study was broken off
table, JSON, picture         :func:`add_output_options`, :class:`Outputs`
===========================  ===================================================================================

The systems in ``models/`` are studied with nothing else; :func:`phyfilter_ctl.fmi.hand_over` hands their parts over.
"""

from .._renamed import attached

# The options of a study need none of what runs it: the help of a command is quick.
__getattr__, __dir__, __all__ = attached(__name__, __file__)
