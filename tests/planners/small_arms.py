"""Arms unlike the SO-101, as texts."""

# A mast that turns without end, an arm that lifts, and a sliding rod at its end; it can hit its own foot.
CRANE_URDF = """
<robot name="crane">
  <link name="foot"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  <link name="mast">
    <collision><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.02" length="0.2"/></geometry></collision>
  </link>
  <link name="boom">
    <collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.02 0.02"/></geometry></collision>
  </link>
  <link name="rod"><collision><origin xyz="0.05 0 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="turn" type="continuous">
    <parent link="foot"/><child link="mast"/><origin xyz="0 0 0.06"/><axis xyz="0 0 1"/><limit effort="1" velocity="1"/>
  </joint>
  <joint name="lift" type="revolute">
    <parent link="mast"/><child link="boom"/><origin xyz="0 0 0.21"/><axis xyz="0 1 0"/>
    <limit effort="1" velocity="1" lower="-1.5" upper="1.5"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="boom"/><child link="rod"/><origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
    <limit effort="1" velocity="0.1" lower="0" upper="0.1"/>
  </joint>
</robot>
"""

CRANE_SRDF = """
<robot name="crane">
  <group name="arm"><chain base_link="foot" tip_link="rod"/></group>
</robot>
"""


def stl(triangles_m):
    """Triangles, shape (n, 3, 3) [m], as the text of an STL file."""
    facets = []
    for corners in triangles_m:
        vertices = "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        facets.append(f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    return "solid shape\n" + "".join(facets) + "endsolid shape\n"


def _revolute(name, parent, child, xyz, axis, more=""):
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/><limit effort="1" velocity="1" lower="-1.2" upper="1.2"/>{more}</joint>'
    )


def _rod(name, length_m):
    half_m = 0.5 * length_m
    shape = f'<origin xyz="{half_m} 0 0"/><geometry><box size="{length_m} 0.02 0.02"/></geometry>'
    return f'<link name="{name}"><collision>{shape}</collision></link>'


# A palletizer, whose wrist turns back what the boom turns, and which has two fingers on one motor. The boom
# and its joint have one name, the wrist has an offset, and the base floats above the floor.
PALLETIZER_URDF = (
    '<robot name="palletizer"><link name="floor"/>'
    '<link name="base"><collision><geometry><box size="0.1 0.1 0.04"/></geometry></collision></link>'
    '<link name="column"/>'
    + _rod("boom", 0.3)
    + _rod("wrist", 0.1)
    + _rod("left", 0.05)
    + _rod("right", 0.05)
    + '<joint name="free" type="floating"><parent link="floor"/><child link="base"/></joint>'
    + _revolute("turn", "base", "column", "0 0 0.1", "0 0 1")
    + _revolute("boom", "column", "boom", "0 0 0.05", "0 1 0")
    + _revolute("level", "boom", "wrist", "0.32 0 0", "0 1 0", '<mimic joint="boom" multiplier="-1" offset="0.3"/>')
    + _revolute("grip", "wrist", "left", "0.12 0.02 0", "0 0 1")
    + _revolute("follow", "wrist", "right", "0.12 -0.02 0", "0 0 1", '<mimic joint="grip" multiplier="-1"/>')
    + "</robot>"
)

PALLETIZER_SRDF = """
<robot name="palletizer">
  <virtual_joint name="ground" type="fixed" parent_frame="world" child_link="floor"/>
  <group name="arm"><chain base_link="base" tip_link="wrist"/></group>
  <group name="hand"><joint name="grip"/></group>
</robot>
"""
