"""Other renderers on a headset's rays, compared with Embree."""
