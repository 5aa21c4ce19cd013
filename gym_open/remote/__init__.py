"""The interface of the paper's supplement, in this process or on a server."""
