"""The services under ``/rosapi/``: what topics, services, types, nodes and parameters there are."""
