"""Controllers wrapped as ECUs: frames in, frames out."""
