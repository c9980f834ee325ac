"""How safe, quick and comfortable platoons form: random scenarios, the shipped ones, and the price of comfort."""
