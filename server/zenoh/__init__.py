"""Topics, services and actions shared with other machines over zenoh, in the way of rmw_zenoh."""
