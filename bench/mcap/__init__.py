"""The MCAP container as such, whole or broken: written by chunks, walked, summarised, recovered. It knows no bus."""
