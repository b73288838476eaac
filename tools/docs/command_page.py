"""docs/reference/commands.md: every command with its arguments and options, as the command line itself knows them."""

from __future__ import annotations

from typing import Any

import typer.main

from pdfem_mpi.command.cli import app
from tools.docs.markdown import code, table
from tools.docs.result_pages import words

INTRODUCTION = """# Commands

`pdfem COMMAND --help` says the same in the terminal. `pdfem --version` prints the version; `pdfem --install-completion`
makes the shell complete commands and options. Every command ends with one of the [exit codes](exit_codes.md).
"""


def commands() -> dict[str, Any]:
    """The commands by their names, in the order of the help."""
    return dict(typer.main.get_command(app).commands)


def command_page() -> str:
    """The page."""
    found = commands()
    rows = [(f"[pdfem {name}](#pdfem-{name})", _sentence(command)) for name, command in found.items()]
    sections = [_section(name, command) for name, command in found.items()]
    variables = [(code(name), code(reader), meaning) for name, reader, meaning in words("environment")["variables"]]
    environment = f"## Environment variables\n\n{table(('variable', 'read by', 'meaning'), variables)}"
    return "\n".join([INTRODUCTION, table(("command", "what it does"), rows), *sections, environment])


def _section(name: str, command: Any) -> str:
    usage = " ".join(filter(None, ("pdfem", name, *(_usage(one) for one in command.params))))
    rows = [_row(one) for one in command.params if "--help" not in one.opts]
    listed = f"\n{table(('argument or option', 'default', 'meaning'), rows)}" if rows else ""
    return f"## pdfem {name}\n\n{_sentence(command)}\n\n    {usage}\n{listed}"


def _sentence(command: Any) -> str:
    return " ".join((command.help or "").split())


def _usage(one: Any) -> str:
    if one.param_type_name == "argument":
        return _placeholder(one)
    return "" if "--help" in one.opts else f"[{_spelt(one).replace(', ', '|')}]"


def _spelt(one: Any) -> str:
    names = "/".join(filter(None, (", ".join(one.opts), ", ".join(one.secondary_opts))))
    return names if one.is_flag else f"{names} {_placeholder(one)}"


def _placeholder(one: Any) -> str:
    """What stands for the value; options without a word of their own are numbers."""
    return (one.metavar or "N").strip("{}")


def _row(one: Any) -> tuple[str, str, str]:
    if one.param_type_name == "argument":
        return code(_placeholder(one)), "required" if one.required else "-", one.help or ""
    shown = getattr(one, "show_default", None)
    default = _default(one) if not isinstance(shown, str) else code(shown) if "<" in shown else shown
    return code(_spelt(one)), default, (one.help or "").lstrip("; ")


def _default(one: Any) -> str:
    if one.is_flag:
        on = bool(one.default)
        return "-" if not on else code(one.opts[0])
    return "-" if one.default in (None, ()) or callable(one.default) else code(one.default)
