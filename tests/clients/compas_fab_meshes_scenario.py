"""Loads a robot's description and meshes as compas_fab does with ROS 2; prints the vertices of each mesh as JSON.

Usage: python compas_fab_meshes_scenario.py HOST PORT
"""

import json
import sys

from compas_fab.backends import RosClient

STEP_TIMEOUT_S = 120.0


def main(host: str, port: int) -> None:
    """Load all that the description names."""
    client = RosClient(host, port)
    client.run(STEP_TIMEOUT_S)
    cell = client.load_robot_cell(load_geometry=True, http_file_server_base_url=f"http://{host}:{port}/robot")
    shapes = [visual.geometry.shape for link in cell.robot_model.links for visual in link.visual]
    meshes = {shape.filename: shape.meshes for shape in shapes if hasattr(shape, "filename")}
    print(json.dumps({name: [mesh.number_of_vertices() for mesh in found] for name, found in meshes.items()}))
    client.terminate()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
