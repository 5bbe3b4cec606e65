"""An arm's base that leans: by the torques of its joints, gravity is not quite where the vehicle file says."""
