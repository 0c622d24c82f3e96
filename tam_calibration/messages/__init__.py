"""What carries messages: serialised topics, their joining into samples by stamps, and the layout of point clouds."""
