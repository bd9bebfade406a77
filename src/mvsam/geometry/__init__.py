"""Cameras, poses and the warp of Eq. 1; nothing here is learned."""
