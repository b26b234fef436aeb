"""Runs the code of a notebook as Jupyter would, without Jupyter: run_notebook.py NOTEBOOK NAME=VALUE...

The values take the place of those in the cell with the tag `parameters`. What a cell ends with is shown, as PNG where it has one.
"""

import ast
import json
import sys

notebook, *values = sys.argv[1:]
space = {}
for cell in json.load(open(notebook))["cells"]:
    if cell["cell_type"] != "code":
        continue
    tree = ast.parse("".join(cell["source"]), notebook)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, notebook, "exec"), space)
    if "parameters" in cell["metadata"].get("tags", []):
        space.update(value.split("=", 1) for value in values)
    if last is not None:
        shown = eval(compile(ast.Expression(last.value), notebook, "eval"), space)
        picture = getattr(shown, "_repr_png_", lambda: None)()
        print(f"a picture of {len(picture)} bytes" if picture and picture.startswith(b"\x89PNG") else shown)
