"""Planning on the workers of a Dask cluster, beside the planner processes of this machine."""
