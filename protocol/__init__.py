"""The wire: rosbridge v2 frames in, operations out, and back. No sockets, no clock, no asyncio."""
