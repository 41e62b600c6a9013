"""The imports of the project's files, drawn from their code: all of them, also those inside functions."""

import ast
import contextlib
import functools
import pathlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

ROOT = pathlib.Path(__file__).resolve().parent.parent
TREES = ("optim", "replay", "tools")


@dataclass(frozen=True)
class Import:
    """One import statement's name: `target` is a module of the project, or a name outside it."""

    file: str
    """Module that imports."""
    line: int
    target: str
    """Module that is imported; of `from a import b`, `a.b` where that is a module of the project, else `a`."""
    name: str
    """What is imported from the target, empty for the module itself."""
    bound: str
    """The expression that reads what was imported, such as `optim.model` or `Path`."""
    is_for_types: bool
    """Whether it stands under `if TYPE_CHECKING`."""

    def __str__(self) -> str:
        what = f"{self.target}.{self.name}" if self.name else self.target
        return f"{self.file}:{self.line} imports {what}"


@functools.cache
def modules() -> Mapping[str, pathlib.Path]:
    """Every module of the project by its dotted name; a package's `__init__` has the name of the package."""
    found = {}
    for path in sorted(path for tree in TREES for path in (ROOT / tree).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@functools.cache
def tree_of(module: str) -> ast.Module:
    """The parsed source of a module."""
    return ast.parse(modules()[module].read_text(encoding="utf-8"))


@functools.cache
def imports() -> tuple[Import, ...]:
    """Every import of every module."""
    return tuple(each for module in modules() for each in imports_of(module, tree_of(module), modules()))


def imports_of(module: str, tree: ast.Module, known: Iterable[str]) -> Iterator[Import]:
    """The imports of one parsed module. `known`: the names of the project's modules."""
    known = set(known)
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                bound = alias.asname or alias.name
                yield Import(module, node.lineno, alias.name, "", bound, id(node) in for_types)
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(module, node, known)
            for alias in node.names:
                inner, bound = f"{base}.{alias.name}", alias.asname or alias.name
                target, name = (inner, "") if inner in known else (base, alias.name)
                yield Import(module, node.lineno, target, name, bound, id(node) in for_types)
        elif isinstance(node, ast.Call) and _called(node) in ("import_module", "__import__") and node.args:
            first = node.args[0]
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield Import(module, node.lineno, first.value, "", "", id(node) in for_types)


def names_read(tree: ast.Module) -> set[str]:
    """Names and dotted expressions that are read in a module, also in quoted annotations, and those in `__all__`."""
    found = set()
    for node in (inner for each in [tree, *_quoted(tree)] for inner in ast.walk(each)):
        if isinstance(node, ast.Attribute) or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)):
            found.add(ast.unparse(node))
        elif isinstance(node, ast.Assign) and any(ast.unparse(target) == "__all__" for target in node.targets):
            found |= set(ast.literal_eval(node.value))
    return found


def _quoted(tree: ast.Module) -> Iterator[ast.AST]:
    """The annotations that stand in quotes, parsed."""
    for node in ast.walk(tree):
        annotation = getattr(node, "annotation", None) or getattr(node, "returns", None)
        for part in ast.walk(annotation) if isinstance(annotation, ast.AST) else ():
            if isinstance(part, ast.Constant) and isinstance(part.value, str):
                with contextlib.suppress(SyntaxError):
                    yield ast.parse(part.value, mode="eval")


def circles(arrows: Iterable[tuple[str, str]]) -> list[list[str]]:
    """The strongly connected components of more than one node, each sorted (Tarjan)."""
    graph: dict[str, set[str]] = {}
    for start, end in arrows:
        graph.setdefault(start, set()).add(end)
        graph.setdefault(end, set())
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        for after in sorted(graph[node]):
            if after not in number:
                visit(after)
                low[node] = min(low[node], low[after])
            elif after in stack:
                low[node] = min(low[node], number[after])
        if low[node] == number[node]:
            place = stack.index(node)
            if len(stack) - place > 1:
                found.append(sorted(stack[place:]))
            del stack[place:]

    for node in sorted(graph):
        if node not in number:
            visit(node)
    return found


def _absolute(module: str, node: ast.ImportFrom, known: set[str]) -> str:
    """The module that a `from` names, its leading dots resolved."""
    if not node.level:
        return node.module or ""
    is_package = any(name.startswith(module + ".") for name in known)
    parts = module.split(".")[: None if is_package and node.level == 1 else 1 - node.level - (not is_package) or None]
    return ".".join([*parts, *([node.module] if node.module else [])])


def _called(node: ast.Call) -> str:
    return ast.unparse(node.func).rpartition(".")[2]
