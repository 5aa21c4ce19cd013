"""The world on another host, behind the interface of the paper's supplement."""
