"""Blocks go to another process and back, are copied, and print their ports."""

import copy
import pickle

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, simulate
from phyfilter_ctl.blocks import (
    BlockFunctions,
    Variable,
    delay_line,
    function_block,
    phyfilter_block,
    sampled_block,
)

F = PhyFilter([400.0, 40.0])


def lag():
    t, x, u, p = (ca.SX.sym(name) for name in "txup")
    return function_block(
        BlockFunctions(
            (Variable("y"),), (Variable("u"),), (Variable("y"),), (Variable("T", 0.5, "s"),),
            ca.Function("dynamics", [t, x, u, p], [(u - x) / p]), ca.Function("output", [t, x, u, p], [x])),
        name="lag",
    )  # fmt: skip


BLOCKS = {
    "continuous filter": lambda: phyfilter_block(F, 2),
    "discrete filter": lambda: phyfilter_block(F.sampled(0.01), 2),
    "sampled filter": lambda: sampled_block(F.sampled(0.01), 2),
    "sampled state space": lambda: sampled_block(
        ct.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.01, inputs="e", name="pi")
    ),
    "sampled transfer function": lambda: sampled_block(ct.tf([1.0], [1.0, -0.5], 0.01)),
    "delay": lambda: delay_line(["u[0]", "u[1]"], 2, 0.01),
    "functions": lag,
}
WAYS = {
    "pickle": lambda block: pickle.loads(pickle.dumps(block)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


def answer(block):
    """What it does for 0.1 s from inputs that differ."""
    t = np.arange(11) * 0.01
    inputs = np.sin(np.outer(np.arange(1.0, block.ninputs + 1.0), 7.0 * t + 0.3))
    if getattr(block, "period", None):
        return simulate(block, t, inputs).outputs
    return ct.input_output_response(block, t, inputs).outputs


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", BLOCKS)
def test_the_same_block_comes_back(kind, way):
    block = BLOCKS[kind]()
    before = answer(block)  # what it caches must not be in the way
    again = WAYS[way](block)
    assert type(again) is type(block)
    assert (again.name, again.dt, again.state_labels) == (block.name, block.dt, block.state_labels)
    assert (again.input_labels, again.output_labels) == (block.input_labels, block.output_labels)
    assert str(again).split("at 0x")[0] == str(block).split("at 0x")[0]
    assert np.array_equal(answer(again), before)


@pytest.mark.parametrize("kind", BLOCKS)
def test_it_prints_its_ports(kind):
    block = BLOCKS[kind]()
    for label in block.input_labels + block.output_labels:
        assert label in str(block)


def test_a_restored_block_is_independent():
    block = phyfilter_block(F, 1)
    again = pickle.loads(pickle.dumps(block))
    assert again.updfcn.__self__ is again
    assert again.rest_state([3.0]).tolist() == block.rest_state([3.0]).tolist()
