"""`mvsam data check`: what a scene holds, and whether its cameras are meant as we read them."""
