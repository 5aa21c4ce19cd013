# MuJoCo ships compiled modules without type stubs: what is used as a type is named here, the rest is Any.
from typing import Any

class MjModel:
    @staticmethod
    def from_xml_string(xml: str) -> MjModel: ...
    def __getattr__(self, name: str) -> Any: ...

class MjData:
    time: float
    ntree_awake: int
    nbody_awake: int
    nv_awake: int
    def __init__(self, model: MjModel) -> None: ...
    def __getattr__(self, name: str) -> Any: ...

def __getattr__(name: str) -> Any: ...
