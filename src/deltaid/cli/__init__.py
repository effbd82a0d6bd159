"""The command line: `deltaid COMMAND`, one module a command."""

from deltaid.cli.app import main as main
