"""Hook of mkdocs: one page of the API reference per package and room, made from the sources when the site is built.

The pages follow the folders of ``ros_ws/src``, so that a module that moves needs no edit here. Sources are parsed and
never imported.
"""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

SOURCES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
INDEX, INTERFACES = "api/index.md", "api/isf_msgs.md"


def packages() -> list[str]:
    """Python packages of the workspace by name."""
    return sorted(path.name for path in SOURCES.iterdir() if (path / path.name / "__init__.py").is_file())


def modules(folder: Path) -> list[str]:
    """Public modules in a folder, without those below it."""
    return sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))


def rooms(package: str) -> list[Path]:
    """The package's folder and those inside it that hold modules."""
    folder = SOURCES / package / package
    return [folder, *sorted(path.parent for path in folder.rglob("*/__init__.py") if path.parent != folder)]


def page(name: str, folder: Path) -> str:
    """Markdown of one room: the package's text, then every module."""
    lines = [f"# {name}", f"::: {name}", "    options: {show_root_heading: false, members: false}", ""]
    for module in modules(folder):
        lines += [f"::: {name}.{module}", ""]
    return "\n".join(lines)


def interfaces() -> str:
    """Markdown of all messages, services and actions: their files, whose comments say unit, frame and shape."""
    lines = ["# isf_msgs", "", "Messages, services and actions. Arrays are flat; comments give unit, frame and shape."]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        lines += ["", f"## {title}"]
        for path in sorted((SOURCES / "isf_msgs" / kind).iterdir()):
            lines += ["", f"### {path.stem}", "", "```text", path.read_text(encoding="utf-8").strip(), "```"]
    return "\n".join(lines) + "\n"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The pages in the navigation, in place of the entry ``api/``."""
    api: list[object] = [{"All packages": INDEX}, {"isf_msgs": INTERFACES}]
    for package in packages():
        folder = SOURCES / package / package
        names = [".".join((package, *room.relative_to(folder).parts)) for room in rooms(package)]
        api.append({package: [{name: f"api/{name}.md"} for name in names]})
    config.nav = [{"API": api} if entry == {"API": "api/"} else entry for entry in config.nav or []]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages."""
    index = ["# API", "", "Public modules, classes and functions by package and room.", ""]
    for package in packages():
        folder = SOURCES / package / package
        index += [f"## {package}", ""]
        for room in rooms(package):
            name = ".".join((package, *room.relative_to(folder).parts))
            first = (room / "__init__.py").read_text(encoding="utf-8").split('"""')[1].split("\n")[0]
            index.append(f"* [{name}]({name}.md): {first}")
            files.append(File.generated(config, f"api/{name}.md", content=page(name, room)))
        index.append("")
    index += ["## isf_msgs", "", "* [isf_msgs](isf_msgs.md): Messages, services and actions."]
    files.append(File.generated(config, INTERFACES, content=interfaces()))
    files.append(File.generated(config, INDEX, content="\n".join(index)))
    return files
