"""Networks in the ONNX format: ``_reader`` brings in the graph of a file, ``_walk`` takes it node by node through
``_operators``, and ``network`` is the learned model."""

from .graph import OnnxGraph, OnnxNode
from .network import OnnxNetwork

__all__ = ["OnnxGraph", "OnnxNetwork", "OnnxNode"]
