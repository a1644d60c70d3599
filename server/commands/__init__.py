"""The commands of ``armbridge``, one module each.

A command is a module with ``add_parser``, which describes its options, and ``run``, which carries it out and returns an
exit code of :class:`server.commands.terminal.ExitCode`.
"""
