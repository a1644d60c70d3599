"""Planning scene: collision objects, attached objects and allowed collisions, with MoveIt's topics and services."""
