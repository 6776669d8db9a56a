"""Networks in the ONNX format: ``reader`` brings in the graph of a file, ``walk`` takes it node by node through
``operators``, and ``network`` is the learned model."""

from .graph import OnnxGraph, OnnxNode
from .network import OnnxNetwork

__all__ = ["OnnxGraph", "OnnxNetwork", "OnnxNode"]
