"""A dora node: dora's own Python API, and behind it the stage in Rust."""

import sys
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_loader

from dora import Node

loader = ExtensionFileLoader("over_dora", sys.argv[1])
module = module_from_spec(spec_from_loader("over_dora", loader))
loader.exec_module(module)
module.play(Node(), sys.argv[1:])
