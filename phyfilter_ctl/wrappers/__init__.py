"""The filter in a loop that exists: between a controller and its actuators, a Gymnasium environment, MuJoCo, ROS 2.

``feedforward`` has the function that all share, ``u = feedforward(time, y, u)``; ``simulators`` (extra ``mujoco``) has
a MuJoCo model as the prior; ``ros2`` has a node, for where ROS 2 is. ``phyfilter_ctl.wrappers.environments`` (extra
``gymnasium``, imported by its name) wraps environments, one or many.
"""

from .._renamed import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
