"""ROS 2: the unknown force on a body, by messages; the estimator needs no ROS, the node runs where ``rclpy`` is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import _signals
from ..filter import LiveFilter

__all__ = ["ForceEstimator", "Stamped", "force_node"]

Array = NDArray[np.floating]
_ROUND = 10_000_000  # s, 116 days: a double resolves 2 ns of it


class Stamped(Protocol):
    """A message whose ``header`` (std_msgs/Header) has ``stamp`` and ``frame_id``."""

    header: Any


class ForceEstimator:
    """f_hat of m v' = F + weight + f, from velocities and commanded forces as messages of one frame.

    Parameters
    ----------
    live : LiveFilter
        Of three channels, with ``g="hold"``.
    mass : float
        kg.
    frame_id : str
        Of velocity and force; ValueError for a message in another one.
    weight : (3,) array
        Known constant force in that frame in N, such as (0, 0, -9.81 mass) where z points up; zero where the command
        is without gravity.
    """

    def __init__(
        self, live: LiveFilter, *, mass: float, frame_id: str, weight: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> None:
        self.live = live
        self.mass: float = _signals.number("mass", mass, "kg", above=0.0)
        self.frame_id = frame_id
        self.weight: Array = _signals.array("weight", weight, (3,))
        self._force: Array = self.weight
        self._origin: int | None = None

    def on_force(self, message: Stamped) -> None:
        """A WrenchStamped message: the force that acts from now on, to be told after the velocity of that time."""
        self._force = self.weight + self._vector(message, "wrench", "force")

    def on_velocity(self, message: Stamped) -> Array:
        """A TwistStamped message: f_hat (3,) in N at its stamp, whatever came late, double or not finite."""
        v = self._vector(message, "twist", "linear")
        return self.live.step(self.seconds(message), v, self._force, inertia=self.mass)

    def seconds(self, message: Stamped) -> float:
        """Stamp of a message since a round second, the same after a restart; so no nanosecond is rounded away."""
        stamp = message.header.stamp
        if self._origin is None:
            self._origin = int(stamp.sec) // _ROUND * _ROUND
        return (int(stamp.sec) - self._origin) + 1e-9 * int(stamp.nanosec)

    def _vector(self, message: Any, outer: str, inner: str) -> Array:
        frame = message.header.frame_id
        if frame != self.frame_id:
            raise ValueError(f"{outer}: expected the frame {self.frame_id!r}, got {frame!r}; turn it first")
        entry = getattr(getattr(message, outer), inner)
        return np.array([entry.x, entry.y, entry.z], dtype=float)


def force_node(estimator: ForceEstimator, *, name: str = "phyfilter") -> Any:
    """An rclpy.node.Node around an estimator, for ``rclpy.spin`` after ``rclpy.init``.

    It hears ``~/velocity`` (TwistStamped) and ``~/force`` (WrenchStamped) and tells ``~/f_hat``, a WrenchStamped with
    the velocity's header. At the end the logger of the node (``name``) has the health record.
    """
    try:
        from geometry_msgs.msg import TwistStamped, WrenchStamped  # pyright: ignore[reportMissingImports]
        from rclpy.node import Node  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ImportError("force_node needs ROS 2, which pip does not have: source its setup") from error
    node = Node(name)
    publisher = node.create_publisher(WrenchStamped, "~/f_hat", 10)

    def hear(message: Any) -> None:
        f_hat = estimator.on_velocity(message)
        answer = WrenchStamped()
        answer.header = message.header
        answer.wrench.force.x, answer.wrench.force.y, answer.wrench.force.z = map(float, f_hat)
        publisher.publish(answer)

    node.create_subscription(WrenchStamped, "~/force", estimator.on_force, 10)
    node.create_subscription(TwistStamped, "~/velocity", hear, 10)
    node.context.on_shutdown(lambda: node.get_logger().info(estimator.live.health.describe()))
    return node
