"""Takes an operator's orders: to load a version, and to unload one."""

from collections.abc import Callable

from taxel.administration import Order, pack_version
from taxel.errors import InvalidArgument, NotFound, PermissionDenied, RequestError
from taxel_server.engine import Engine
from taxel_server.loading.exchange import LOADING, Exchange, place_of
from taxel_server.options import Admin

Answer = Callable[[bytes | RequestError], None]


class Administration:
    """Carries out the orders that are allowed.

    Args:
        engine: whose versions these are.
        exchange: what loads and unloads them; None where nothing can be loaded.
        admin: from where orders are taken. Where that depends on the client, zenoh's access control has
            let the order through already (`taxel_server.transports.access`).
    """

    def __init__(self, engine: Engine, exchange: Exchange | None, admin: Admin) -> None:
        self._engine = engine
        self._exchange = exchange
        self._takes_none = admin == "off"

    def take(self, path: str, payload: bytes, answer: Answer) -> bool:
        """Carry out the order at a path; False if there is none, and nothing was answered.

        Args:
            path: of the request.
            payload: its content.
            answer: called once, on any thread, when it is done.
        """
        try:
            order = Order.read(path, payload)
            if order is None:
                return False
            self._carry_out(order, answer)
        except RequestError as error:
            answer(error)
        return True

    def _carry_out(self, order: Order, answer: Answer) -> None:
        if self._takes_none:
            raise PermissionDenied(f"{order.path}: this server takes no orders: it runs with --admin off")
        if self._exchange is None:
            raise NotFound(f"{order.path}: this server loads nothing while it runs")
        if order.action == "unload":
            version = order.version
            if version is None:
                newest = self._engine.newest(order.name)
                if newest is None:
                    raise NotFound(f"no version of model {order.name!r} is loaded")
                version = newest.manifest.version
            self._exchange.unload((order.name, version))
            answer(pack_version(order.name, version))
            return
        place = place_of(self._engine, order.name, order.version)
        newest = self._engine.newest(order.name)
        if order.shadow and (newest is None or newest.manifest.version == place[1]):
            raise InvalidArgument(f"{order.path}: a shadow needs another version beside it, which answers")
        # The index knows it from now on, and nobody else loads it.
        self._engine.scan(hold=LOADING)
        self._exchange.load(
            place, lambda refusal: answer(refusal or pack_version(*place)), shadow=order.shadow
        )
