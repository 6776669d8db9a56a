"""phyfilter-ctl: a control-systems toolbox around PhyFilter.

A robot obeys ``M x' = g + f`` with g known and f only partly known, by a learned model f_theta that fails outside its
training data. PhyFilter passes the learning residual through a designed filter F, without differentiating x:
``f_hat = f_theta + F(s) (M x' - g - f_theta)``.

==============  =======================================================================================
choose F        :func:`place_poles`, :func:`lowpass`, :func:`bandpass`, :class:`PhyFilter`
learn F         :func:`learn`, :func:`learn_jointly`; :mod:`phyfilter_ctl.design` the paper's way
what it missed  :func:`estimate`: the force in recordings, which filter shows it;
                :func:`smooth_label`; its noise where it is known: :class:`Noise`; :func:`model_value`: whether the
                learned model is worth it
what of it      :func:`separate`: payload, wind, drag, a model's scale, or only their sum
understand it   :func:`frequency_response`, :func:`error_bound`, :func:`error_variance`, :func:`margins`,
                :func:`inertia_tolerance`, :func:`saturation_margin`, :func:`largest_bandwidth`, :func:`tracking_error`,
                :func:`analyze`, :func:`between`; what surrounds a filter: :class:`Loop`, :class:`Bounded`,
                :class:`Gaussian`; designs from them: :mod:`phyfilter_ctl.design.optimal`, :func:`trade_off`
run it          :class:`SampledPhyFilter` (``PhyFilter.sampled``), :func:`stack`
connect it      :func:`phyfilter_block`, :func:`sampled_block`, :func:`learned_block`, :func:`plant`: python-control
                systems, wired with ``control.interconnect``; :func:`lookup_table`,
                :func:`transport_delay`
draw it         :func:`draw`: block diagrams as pictures
events          :func:`hybrid`, :func:`event`: impacts, switches, contact
simulate        :func:`flatten`, :func:`simulate`, :func:`simulate_batch`, :func:`sensitivity`
hand it over    :func:`export_c`, :func:`export_target`, :func:`export_fmu`, :func:`export_ssp`
co-simulate     :func:`import_fmu`, :func:`cosimulate`
keep it         :func:`save`, :func:`load` (TOML)
answers         :class:`Result`, :class:`Status`: what every answer has in common
data            :class:`Recording`, :func:`split`; :func:`open_log`: robots' own logs; :class:`Robot`: what
                is in them
models of f     :func:`learned_model` (scikit-learn, PyTorch, ONNX, functions), :mod:`phyfilter_ctl.learned`
others' ways    :mod:`phyfilter_ctl.baselines`
your own study  :mod:`phyfilter_ctl.study`
the paper's     :mod:`phyfilter_ctl.models`
==============  =======================================================================================
"""

from ._renamed import attached

# A room is imported when one of its names is first used: the command's help needs none of them.
__getattr__, __dir__, __all__ = attached(__name__, __file__)
__version__ = "0.2.0"
