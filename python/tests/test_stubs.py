"""The stubs name what the compiled module has, with the parameters that it takes."""

import ast
import inspect
from pathlib import Path

import pytest

import rig_reflectometry as rig
from rig_reflectometry import _native, errors, records

STUB = ast.parse((Path(rig.__file__).parent / "_native.pyi").read_text())
CLASSES = {
    node.name: node
    for node in STUB.body
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
}
FIT_OPTIONS = next(node for node in STUB.body if getattr(node, "name", "") == "_FitOptions")
FUNCTIONS = {node.name: node for node in STUB.body if isinstance(node, ast.FunctionDef)}


def public(names):
    return {name for name in names if not name.startswith("_")}


def parameters(function):
    """Those with a place in their order, and the keywords."""
    arguments = function.args
    placed = [argument.arg for argument in arguments.posonlyargs + arguments.args]
    keywords = {argument.arg for argument in arguments.kwonlyargs}
    if arguments.kwarg:
        assert ast.unparse(arguments.kwarg.annotation) == "Unpack[_FitOptions]"
        keywords |= {option.target.id for option in FIT_OPTIONS.body}
    return [name for name in placed if name != "self"], keywords


def parameters_of(built_in):
    found = inspect.signature(built_in).parameters.values()
    keywords = {one.name for one in found if one.kind is one.KEYWORD_ONLY}
    return [one.name for one in found if one.name not in keywords | {"self"}], keywords


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


def test_the_options_of_a_fit_are_read(scene):
    for option in FIT_OPTIONS.body:
        with pytest.raises(TypeError, match=f"argument '{option.target.id}'"):
            rig.fit(scene, [], **{option.target.id: object()})


def test_everything_public_is_documented():
    for name in rig.__all__:
        thing = getattr(rig, name)
        assert name == "__version__" or inspect.getdoc(thing), name
        if inspect.isclass(thing) and thing.__module__ not in (records.__name__, errors.__name__):
            for member in public(vars(thing)):
                assert inspect.getdoc(getattr(thing, member)), f"{name}.{member}"
