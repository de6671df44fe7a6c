"""The stubs name what the compiled module has, with the parameters that it takes."""

import ast
import inspect
from pathlib import Path

import pytest

import rig_reflectometry as rig
from rig_reflectometry import _native, errors, records

STUB = ast.parse((Path(rig.__file__).parent / "_native.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
FUNCTIONS = {node.name: node for node in STUB.body if isinstance(node, ast.FunctionDef)}


def public(names):
    return {name for name in names if not name.startswith("_")}


def parameters(function):
    arguments = function.args
    named = arguments.posonlyargs + arguments.args + arguments.kwonlyargs
    return [argument.arg for argument in named if argument.arg != "self"]


def parameters_of(built_in):
    return [name for name in inspect.signature(built_in).parameters if name != "self"]


def test_the_module():
    assert set(CLASSES) | set(FUNCTIONS) | {"VERSION"} == public(dir(_native))
    for name, function in FUNCTIONS.items():
        assert parameters(function) == parameters_of(getattr(_native, name)), name


@pytest.mark.parametrize("name", CLASSES)
def test_classes(name):
    built_in = getattr(_native, name)
    members = {node.name: node for node in CLASSES[name].body if isinstance(node, ast.FunctionDef)}
    assert public(members) == public(vars(built_in))
    for member, node in members.items():
        is_property = any(getattr(d, "id", "") == "property" for d in node.decorator_list)
        assert is_property == inspect.isgetsetdescriptor(getattr(built_in, member)), member
        if not is_property and member in public(members):
            assert parameters(node) == parameters_of(getattr(built_in, member)), member


def test_everything_public_is_documented():
    for name in rig.__all__:
        thing = getattr(rig, name)
        assert name == "__version__" or inspect.getdoc(thing), name
        if inspect.isclass(thing) and thing.__module__ not in (records.__name__, errors.__name__):
            for member in public(vars(thing)):
                assert inspect.getdoc(getattr(thing, member)), f"{name}.{member}"
