"""``python -m armbridge_mcp``."""

from armbridge_mcp.cli import main

main()
