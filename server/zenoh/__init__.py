"""Topics and services shared with other machines over zenoh, in the way of rmw_zenoh."""
