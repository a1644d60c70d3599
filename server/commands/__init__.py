"""The commands of ``armbridge``, one module each.

A module describes the options of its commands with :func:`server.commands.options.add_command`, which also names the
function that carries the command out; its errors become exit codes in one place.
"""
