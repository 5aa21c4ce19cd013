"""Check hosts and ports, and read the token of a server."""

import ipaddress
import os
import re
from pathlib import Path

from gym_open.errors import UsageError
from gym_open.remote.protocol import TOKEN_VARIABLE

_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]*[A-Za-z0-9])?")
_MIN_TOKEN = 16


def check_host(host: str, name: str) -> None:
    """Raise UsageError unless `host` is an IP address or a host name; `name` is the argument's name in the error."""
    if _ip(host) is None and not _NAME.fullmatch(host):
        raise UsageError(f"{name}: expected an IP address or a host name, got {host!r}")


def check_port(port: int, name: str, *, least: int = 1) -> None:
    """Raise UsageError unless `port` is a TCP port; `name` is the argument's name in the error."""
    if not least <= port <= 65535:
        raise UsageError(f"{name}: expected {least} to 65535, got {port}")


def is_loopback(host: str) -> bool:
    """Whether `host` is reachable only from this machine."""
    address = _ip(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def target(host: str, port: int) -> str:
    """`host:port`, with brackets around an IPv6 address."""
    address = _ip(host)
    return f"[{host}]:{port}" if address is not None and address.version == 6 else f"{host}:{port}"


def _ip(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def read_token(file: Path | None) -> str | None:
    """The token: the text of `file` if that is given, else the environment variable, else None.

    Raises:
        UsageError: if the token cannot be read, is too short to be safe, or is not printable ASCII.
    """
    if file is None:
        source, token = f"environment variable {TOKEN_VARIABLE}", os.environ.get(TOKEN_VARIABLE) or None
    else:
        source = str(file)
        try:
            token = file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"{file}: the token cannot be read: {error}") from None
    if token is None:
        return None
    remedy = "make one: python -c 'import secrets; print(secrets.token_urlsafe())'"
    if len(token) < _MIN_TOKEN:
        raise UsageError(f"{source}: the token has {len(token)} characters, at least {_MIN_TOKEN} are needed; {remedy}")
    if not (token.isascii() and token.isprintable()) or " " in token:
        raise UsageError(f"{source}: the token must be printable ASCII without spaces; {remedy}")
    return token
