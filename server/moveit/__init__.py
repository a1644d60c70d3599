"""MoveIt's topics, services and actions.

Functions that read a client's message raise :exc:`server.errors.RefusedError`; its sentence names the field, the value
and the limit. Their argument ``where`` is the path of the field; arguments such as ``start_rad`` and ``positions_rad``
are the positions of all movable joints by name, None while they are unknown [rad].

The folders import each other in one direction: the modules here, ``scene``, ``requests``, ``goals``; then ``actions``,
``services`` and ``servo``.
"""
