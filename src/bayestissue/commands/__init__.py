"""The commands: each reads, computes, writes whole, and says on the console what was done."""
