"""From a wish of somebody who steers to velocities of the joints, many times a second."""
