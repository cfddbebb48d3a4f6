"""A random walk over the instances of several FMUs: draw a call, make it, judge status, log and values by reference.py.

Every choice comes from `random`, so that a seed is a sequence of calls. A second witness besides the reference: one
instance of each FMU does nothing but step at intervals, and so does one that was reset; both must have the bits of an
instance that was alone.
"""

from __future__ import annotations

import functools
import math
import struct
from collections import Counter
from collections.abc import Callable
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p, create_string_buffer
from dataclasses import dataclass
from math import inf, nan
from random import Random

from . import reference
from .library import DISCARD, ERROR, OK, STATUS, VALUE, WARNING, Library
from .reference import INITIALIZATION, INSTANTIATED, STEPPING, TERMINATED, Memory

H = 1e-3
ALONE = 20  # steps of the run that witnesses are compared with
MOST_INSTANCES = 6
ODD = (nan, inf, -inf, 0.0, -0.0, -1.0, 1e300, -1e300, 5e-324, 1e-300, 1e12, 0.5)
NOT_OFFERED = (
    "CancelStep",
    "GetStatus",
    "GetIntegerStatus",
    "GetStringStatus",
    "SetRealInputDerivatives",
    "GetRealOutputDerivatives",
    "GetDirectionalDerivative",
)
_CATEGORIES = {"logAll": None, "logStatusWarning": WARNING, "logStatusDiscard": DISCARD, "logStatusError": ERROR}


@dataclass
class Twin:
    """An instance and the model of it; warns: whether its warnings reach the host."""

    library: Library
    handle: c_void_p
    name: str
    memory: Memory
    warns: bool
    heard: bool
    alive: bool = True


@dataclass
class Saved:
    """A state that the FMU keeps: the handle, whose it is, and what it holds."""

    library: Library
    handle: c_void_p
    owner: Twin
    memory: Memory
    alive: bool = True


class Walk:
    """Calls on instances of these FMUs; `note` gets every call in words before it is made."""

    def __init__(self, libraries: list[Library], random: Random, note: Callable[[str], None]) -> None:
        self.libraries, self.random, self.note = libraries, random, note
        self.twins: list[Twin] = []
        self.saved: list[Saved] = []
        self.bytes: list[tuple[Library, bytes, Memory]] = []
        self.counts: Counter[tuple[str, str]] = Counter()
        self.made = 0
        self.alone = {library: _alone(library) for library in libraries}
        self.witnesses = {library: (library.new("witness"), 0) for library in libraries}

    def close(self) -> None:
        """Free what is left, so that another walk may follow."""
        for twin in self.twins:
            if twin.alive:
                twin.library.FreeInstance(twin.handle)
        for library, (handle, _) in self.witnesses.items():
            library.FreeInstance(handle)

    # -- making a call

    def call(self, function: str, words: str, twin: Twin | None, allowed: set[int], make: Callable[[], int]) -> int:
        """Make the call and compare its status and its messages with what they must be."""
        library = twin.library if twin else None
        who = f"{library.name}:{twin.name}" if twin else "nobody"
        self.note(f"{self.made} {who} {function} {words}")
        self.made += 1
        for each in self.libraries:
            each.said.clear()
        status = make()
        self.counts[function, STATUS[status]] += 1
        where = f"{function} {words} of {who}"
        said = [message for each in self.libraries for message in each.said]
        expected = " or ".join(STATUS[one] for one in sorted(allowed))
        assert status in allowed, f"{where}: expected {expected}, received {STATUS[status]}, and the messages {said}"
        if not twin or not twin.alive or not twin.heard or status == OK or (status == WARNING and not twin.warns):
            assert not said, f"{where}: expected no message, received {said}"
        else:
            assert said, f"{where}: expected a message with {STATUS[status]}, received none"
            assert {name for name, _, _ in said} == {twin.name}, f"{where}: messages of others: {said}"
            assert max(level for _, level, _ in said) == status, f"{where}: messages of other statuses: {said}"
        return status

    def pick(self) -> Twin:
        """Return an instance, most often a living one."""
        living = [twin for twin in self.twins if twin.alive]
        if not living or (self.random.random() < 0.02 and len(living) < MOST_INSTANCES):
            return self.instantiate()
        gone = [twin for twin in self.twins if not twin.alive]
        if gone and self.random.random() < 0.02:
            return self.random.choice(gone)
        return self.random.choice(living)

    def rarely(self) -> bool:
        return self.random.random() < 0.1

    def anyone(self, twin: Twin) -> tuple[c_void_p, bool]:
        """Return the handle and whether it is right: it may be NULL, invented, or of another FMU."""
        if not twin.alive or self.random.random() > 0.02:
            return twin.handle, twin.alive
        others = [other.handle for other in self.twins if other.library is not twin.library]
        return self.random.choice([c_void_p(), c_void_p(8), c_void_p(self.random.getrandbits(64) | 1), *others]), False

    def simple(self, function: str, twin: Twin, words: str, allowed: set[int], *arguments) -> int:
        """A call that is judged by its status alone; with a wrong handle it is an Error, and nobody is told."""
        handle, right = self.anyone(twin)
        if right:
            return self.call(
                function, words, twin, allowed, lambda: getattr(twin.library, function)(handle, *arguments)
            )
        make = lambda: getattr(twin.library, function)(handle, *arguments)  # noqa: E731
        self.call(f"{function}", f"{words} with handle {handle.value}", None, {ERROR}, make)
        return -1

    # -- instances

    def instantiate(self) -> Twin:
        library = self.random.choice(self.libraries)
        name, logging, heard = f"i{self.made}", self.random.random() < 0.5, not self.rarely()
        self.note(f"{self.made} {library.name} Instantiate {name} {logging} {heard}")
        self.made += 1
        library.said.clear()
        callbacks = library.callbacks if heard else library.silent
        handle = library.instantiate(name, library.guid.encode(), library.resources.encode(), 1, callbacks, logging)
        self.counts["Instantiate", "OK" if handle else "NULL"] += 1
        assert handle, "Instantiate: expected an instance, received NULL"
        assert not library.said
        self.twins.append(Twin(library, c_void_p(handle), name, reference.fresh(library), logging, heard))
        return self.twins[-1]

    def instantiate_wrongly(self) -> None:
        library, other = self.random.sample(self.libraries, 2)
        right = ["wrong", library.guid.encode(), library.resources.encode(), 1, library.callbacks]
        place = self.random.randrange(5)
        wrong = (
            (None, ""),
            (None, b"", other.guid.encode(), library.guid.encode()[:-1]),
            (None, b"", b"file:///nowhere", other.resources.encode(), b"\xff%") if not library.is_native else (),
            (0, 2, -1),
            (None,),
        )[place]
        if not wrong:
            return
        right[place] = self.random.choice(wrong)
        self.note(f"{self.made} {library.name} Instantiate {right}")
        self.made += 1
        library.said.clear()
        assert library.instantiate(*right) is None, f"Instantiate {right}: expected NULL, received an instance"
        self.counts["Instantiate", "NULL"] += 1
        assert len(library.said) == (right[4] is not None), f"Instantiate {right}: expected one line in the log"

    def free_instance(self) -> None:
        if self.random.random() > 0.25:  # else walks are short
            return
        twin = self.pick()
        handle, right = self.anyone(twin)
        self.call("FreeInstance", str(handle.value), None, {OK}, lambda: twin.library.FreeInstance(handle) or OK)
        if right:
            twin.alive = False
            for saved in self.saved:
                saved.alive = saved.alive and saved.owner is not twin
        if len(self.twins) > 4 * MOST_INSTANCES:
            self.twins.remove(next((twin for twin in self.twins if not twin.alive), twin))

    def set_debug_logging(self) -> None:
        twin, on = self.pick(), self.random.random() < 0.5
        names = self.random.choices([*_CATEGORIES, "logAny", "", None], k=self.random.randrange(4))
        array = (c_char_p * len(names))(*(None if name is None else name.encode() for name in names))
        if names and self.rarely():
            self.simple("SetDebugLogging", twin, f"{on} NULL", {ERROR}, c_int(on), c_size_t(len(names)), None)
            return
        known = all(name in _CATEGORIES for name in names)
        before = twin.warns
        if twin.alive:
            twin.warns = on and (not names or "logAll" in names or "logStatusWarning" in names)
        expected = {OK if known else WARNING}
        words = f"{on} {names}"
        if self.simple("SetDebugLogging", twin, words, expected, c_int(on), c_size_t(len(names)), array) < 0:
            twin.warns = before

    # -- modes

    def setup_experiment(self) -> None:
        twin = self.pick()
        start = self.random.choice([0.0, 0.0, 0.5, -2.0, self.random.choice(ODD)])
        stop = self.random.choice([None, None, start + 0.05, start + 1.0, self.random.choice(ODD)])
        tolerance = self.random.choice([0.0, 1e-4, -1.0, nan])
        memory = reference.copy(twin.memory)
        allowed = reference.set_up(memory, start, stop)
        defined, stop_value = c_int(stop is not None), c_double(0.0 if stop is None else stop)
        arguments = (c_int(tolerance != 0.0), c_double(tolerance), c_double(start), defined, stop_value)
        if self.simple("SetupExperiment", twin, f"{start} {stop} {tolerance}", allowed, *arguments) == OK:
            twin.memory = memory

    def enter_initialization_mode(self) -> None:
        twin = self.pick()
        memory = twin.memory
        allowed = {OK if memory.mode == INSTANTIATED and memory.experiment else ERROR}
        if self.simple("EnterInitializationMode", twin, "", allowed) == OK:
            memory.mode, memory.stale, memory.outputs = INITIALIZATION, True, None

    def exit_initialization_mode(self) -> None:
        twin = self.pick()
        memory = twin.memory
        allowed = reference.refreshed(twin.library, memory) if memory.mode == INITIALIZATION else {ERROR}
        if self.simple("ExitInitializationMode", twin, "", allowed) in (OK, WARNING):
            memory.mode, memory.stale, memory.outputs = STEPPING, False, None

    def terminate(self) -> None:
        twin = self.pick()
        if twin.memory.mode == STEPPING and self.random.random() < 0.7:
            return
        if self.simple("Terminate", twin, "", {OK if twin.memory.mode == STEPPING else ERROR}) == OK:
            twin.memory.mode = TERMINATED

    def reset(self) -> None:
        twin = self.pick()
        if twin.memory.mode in (INITIALIZATION, STEPPING) and self.random.random() < 0.7:
            return
        if self.simple("Reset", twin, "", {OK}) == OK:
            twin.memory = reference.fresh(twin.library)

    def lead(self) -> None:
        """Bring an instance to step mode as a host does that makes no mistakes, so that the walk gets there often."""
        twin = self.pick()
        memory = twin.memory
        if not twin.alive or memory.mode != INSTANTIATED or memory.refused:
            return
        library, handle = twin.library, twin.handle
        if not memory.experiment:
            self.call(
                "SetupExperiment", "0", twin, reference.set_up(memory, 0.0, None), lambda: library.setup(handle, 0.0)
            )
        self.call("EnterInitializationMode", "", twin, {OK}, lambda: library.EnterInitializationMode(handle))
        memory.mode, memory.stale, memory.outputs = INITIALIZATION, True, None
        allowed = reference.refreshed(library, memory)
        leave = lambda: library.ExitInitializationMode(handle)  # noqa: E731
        if self.call("ExitInitializationMode", "", twin, allowed, leave) in (OK, WARNING):
            memory.mode, memory.stale = STEPPING, False

    # -- values

    def references(self, library: Library, type_: str) -> tuple[list[int], bool]:
        """Return value references, and whether all are of this type."""
        own = library.references(type_, "input", "parameter", "output")
        everything = [*range(len(library.variables)), len(library.variables), 2**32 - 1, 2**31]
        pool = everything if self.rarely() or not own else own
        drawn = self.random.choices(pool, k=self.random.choice([0, 1, 1, 2, 5, 40]))
        return drawn, set(drawn) <= set(own)

    def get(self) -> None:
        twin = self.pick()
        type_ = self.random.choice(["Real", "Real", "Real", "Integer", "Boolean", "String"])
        references, right = self.references(twin.library, type_)
        values, array = (VALUE[type_] * len(references))(), (c_uint * len(references))(*references)
        missing = self.random.choice(["references", "values"]) if self.rarely() else None
        allowed = reference.got(twin.library, twin.memory) if right else {ERROR}
        if missing:
            allowed = {ERROR}
        if not references:
            allowed = {OK}
        passed = (None if missing == "references" else array, c_size_t(len(references)))
        passed = (*passed, None if missing == "values" else values)
        status = self.simple(f"Get{type_}", twin, f"{references} NULL: {missing}", allowed, *passed)
        if status not in (OK, WARNING) or not references:
            return
        twin.memory.stale = False
        for vr, value in zip(references, values, strict=True):
            expected = twin.memory.values.get(vr)
            assert expected is None or _same(expected, value), f"variable {vr}: expected {expected}, received {value}"

    def set(self) -> None:
        twin = self.pick()
        library = twin.library
        type_ = self.random.choice(["Real", "Real", "Real", "Real", "Integer", "Boolean", "String"])
        references, right = self.references(library, type_)
        if type_ in ("Real", "Integer") and self.random.random() < 0.8:
            pool = library.references(type_, *self.random.choice([("input",), ("parameter",), ("input", "parameter")]))
            references, right = (self.random.choices(pool, k=self.random.randrange(1, 4)) if pool else []), True
        values = [self.value(library, vr, type_) for vr in references]
        missing = self.random.choice(["references", "values"]) if self.rarely() else None
        array = (c_uint * len(references))(*references)
        passed = (None if missing == "references" else array, c_size_t(len(references)))
        passed = (*passed, None if missing == "values" else (VALUE[type_] * len(references))(*values))
        memory = reference.copy(twin.memory)
        allowed = {ERROR}
        if not references:
            allowed = {ERROR if memory.mode == TERMINATED else OK}
        elif right and not missing:
            allowed = reference.set_(library, memory, references, values)
        if self.simple(f"Set{type_}", twin, f"{references} {values} NULL: {missing}", allowed, *passed) >= 0:
            twin.memory = memory

    def value(self, library: Library, vr: int, type_: str):
        if type_ == "String":
            return self.random.choice([None, b"", b"text", b"\xff%s%n"])
        if type_ != "Real":
            return self.random.choice([-1, 2**31 - 1, -(2**31)] if self.rarely() else [0, 1, 1, 2, 2, 3])
        variable = library.variables[vr] if vr < len(library.variables) else None
        kind = self.random.random()
        if kind < 0.06:
            return self.random.choice(ODD)
        if variable is None or variable.causality != "parameter" or variable.type != "Real":
            return nan if kind < 0.12 else self.random.uniform(-1.0, 1.0)
        if kind < 0.09:
            return self.random.choice([nan, inf, -1.0])
        if variable.name == reference.NO_DESIGN[0] and kind < 0.3:
            return reference.NO_DESIGN[1]
        return self.random.choice(reference.usual(variable))

    def observe(self) -> None:
        """Read all outputs: they are as they were if only refused calls came in between."""
        twin = self.pick()
        if not twin.alive:
            return
        memory, references = twin.memory, twin.library.references("Real", "output")
        allowed = reference.got(twin.library, memory)
        values: tuple[float, ...] = ()

        def make() -> int:
            nonlocal values
            status, values = twin.library.get(twin.handle, references)
            return status

        if self.call("GetReal", "all outputs", twin, allowed, make) not in (OK, WARNING):
            return
        memory.stale = False
        if memory.outputs is not None:
            assert _bits(values) == _bits(memory.outputs), f"expected the outputs {memory.outputs}, received {values}"
        memory.outputs = values

    # -- steps

    def do_step(self) -> None:
        twin = self.pick()
        memory = twin.memory
        size = self.random.choice([H, H, H, reference.SHORTEST_STEP, reference.LONGEST_STEP])
        size = self.random.choice(ODD) if self.rarely() else self.random.choice([size, size, -size, 0.0, size / 3.0])
        time = memory.time + self.random.choice([0.0, 0.0, 0.0, 1e-9, -1e-9]) * size
        if self.rarely():
            time = self.random.choice([memory.time + 0.01 * H, memory.time - H, self.random.choice(ODD)])
        allowed = reference.stepped(twin.library, memory, time, size)
        arguments = (c_double(time), c_double(size), c_int(self.random.randrange(2)))
        if self.simple("DoStep", twin, f"{time!r} {size!r}", allowed, *arguments) in (OK, WARNING):
            reference.after_step(twin.library, memory, time, size)

    def steps(self) -> None:
        """Some steps in a row without mistakes, with inputs that vary."""
        twin = self.pick()
        library, memory = twin.library, twin.memory
        if not twin.alive or memory.mode != STEPPING:
            return
        inputs = library.references("Real", "input")
        for _ in range(self.random.randrange(8)):
            values = [self.random.uniform(-1.0, 1.0) for _ in inputs]
            allowed = reference.set_(library, memory, inputs, values)
            self.call(
                "SetReal", f"{inputs} {values}", twin, allowed, lambda v=values: library.set(twin.handle, inputs, v)
            )
            time = memory.time
            allowed = reference.stepped(library, memory, time, H)
            make = lambda t=time: library.step(twin.handle, t, H)  # noqa: E731
            if self.call("DoStep", f"{time!r} {H}", twin, allowed, make) in (OK, WARNING):
                reference.after_step(library, memory, time, H)

    def ask_status(self) -> None:
        twin = self.pick()
        real, flag = c_double(nan), c_int(7)
        function, right, place = self.random.choice([("GetRealStatus", 2, real), ("GetBooleanStatus", 3, flag)])
        kind, null = self.random.choice([right, right, 0, 1, 5, 99]), self.rarely()
        good = kind == right and not null and twin.memory.mode in (STEPPING, TERMINATED)
        arguments = (c_int(kind), None if null else byref(place))
        if self.simple(function, twin, f"{kind} NULL: {null}", {OK if good else ERROR}, *arguments) == OK:
            expected = twin.memory.time if place is real else 0
            assert place.value == expected, f"{function}: expected {expected}, received {place.value}"

    def call_what_is_not_offered(self) -> None:
        function = self.random.choice(NOT_OFFERED)
        self.simple(function, self.pick(), "", {ERROR}, *[None] * 7)

    # -- states

    def get_state(self) -> None:
        twin = self.pick()
        if self.rarely():
            self.simple("GetFMUstate", twin, "NULL", {ERROR}, None)
            return
        before = self.random.choice(self.saved) if self.saved and self.rarely() else None
        place = c_void_p(before.handle.value if before else self.random.choice([0, 0, 0, 12345]))
        if self.simple("GetFMUstate", twin, f"into {place.value}", {OK}, byref(place)) == OK:
            self.keep(twin, before, place, reference.copy(twin.memory))

    def keep(self, twin: Twin, before: Saved | None, place: c_void_p, memory: Memory) -> None:
        if before and before.alive and before.library is twin.library:
            assert place.value == before.handle.value, "expected the state that was there to be overwritten"
            before.owner, before.memory = twin, memory
        else:
            self.saved.append(Saved(twin.library, place, twin, memory))
        while len(self.saved) > 20:
            oldest = self.saved.pop(0)
            if oldest.alive and oldest.owner.alive:
                oldest.library.FreeFMUstate(oldest.owner.handle, byref(oldest.handle))

    def state(self, twin: Twin) -> tuple[c_void_p, Saved | None]:
        """Return a state's handle, and the state if it can be used with this instance."""
        if not self.saved or self.rarely():
            return c_void_p(self.random.choice([0, 1, 12345, self.random.getrandbits(64)])), None
        saved = self.random.choice(self.saved)
        good = saved.alive and saved.library is twin.library
        return c_void_p(saved.handle.value), saved if good else None

    def set_state(self) -> None:
        twin = self.pick()
        handle, saved = self.state(twin)
        allowed = reference.made(twin.library, saved.memory) if saved else {ERROR}
        if self.simple("SetFMUstate", twin, str(handle.value), allowed, handle) in (OK, WARNING):
            twin.memory = reference.copy(saved.memory)

    def free_state(self) -> None:
        twin = self.pick()
        handle, saved = self.state(twin)
        if self.rarely():
            self.simple("FreeFMUstate", twin, "NULL", {OK}, None)
            return
        allowed = {OK if saved or not handle.value else ERROR}
        if self.simple("FreeFMUstate", twin, str(handle.value), allowed, byref(handle)) == OK and saved:
            assert handle.value is None, "expected NULL in the place of a freed state"
            saved.alive = False

    def serialize(self) -> None:
        twin = self.pick()
        handle, saved = self.state(twin)
        if self.rarely():
            self.simple("SerializedFMUstateSize", twin, "NULL", {ERROR}, handle, None)
            return
        size = c_size_t()
        allowed = {OK if saved else ERROR}
        if self.simple("SerializedFMUstateSize", twin, str(handle.value), allowed, handle, byref(size)) != OK:
            return
        room = size.value + self.random.choice([0, 0, 0, 7, -1, -size.value])
        buffer = create_string_buffer(size.value + 8)
        null = self.rarely()
        allowed = {OK if room >= size.value and not null else ERROR}
        arguments = (handle, None if null else buffer, c_size_t(room))
        status = self.simple("SerializeFMUstate", twin, f"{handle.value} {room} NULL: {null}", allowed, *arguments)
        assert buffer.raw[size.value :] == bytes(8), "SerializeFMUstate wrote past the end"
        if status == OK:
            self.bytes = [*self.bytes[-9:], (twin.library, buffer.raw[: size.value], reference.copy(saved.memory))]

    def deserialize(self) -> None:
        if not self.bytes:
            return
        twin = self.pick()
        library, data, memory = self.random.choice(self.bytes)
        good, spoilt = library is twin.library, "whole"
        if self.random.random() < 0.4:
            good, (spoilt, data) = False, self.spoilt(data)
        null = self.random.choice(["bytes", "place"]) if self.rarely() else None
        place = c_void_p(self.random.choice([0, 0, 999]))
        passed = (None if null == "bytes" else data, c_size_t(len(data)), None if null == "place" else byref(place))
        # The state is tried, and the present one comes back.
        both = reference.made(library, memory) | reference.made(twin.library, twin.memory)
        allowed = both if good and not null else {ERROR}
        words = f"{len(data)} bytes of {library.name}, {spoilt}, NULL: {null}"
        if self.simple("DeSerializeFMUstate", twin, words, allowed, *passed) in (OK, WARNING):
            self.keep(twin, None, place, reference.copy(memory))

    def restore_own_bytes(self) -> None:
        """What an instance remembers comes back from its bytes, whatever a host has done to it before."""
        twin = self.pick()
        if not twin.alive:
            return
        library, handle, state, size = twin.library, twin.handle, c_void_p(), c_size_t()
        self.call("GetFMUstate", "of its own", twin, {OK}, lambda: library.GetFMUstate(handle, byref(state)))
        assert library.SerializedFMUstateSize(handle, state, byref(size)) == OK
        buffer = create_string_buffer(size.value)
        assert library.SerializeFMUstate(handle, state, buffer, size) == OK
        assert library.FreeFMUstate(handle, byref(state)) == OK
        read = lambda: library.DeSerializeFMUstate(handle, buffer, size, byref(state))  # noqa: E731
        self.call("DeSerializeFMUstate", "its own bytes", twin, {OK}, read)
        self.call("SetFMUstate", "of its own bytes", twin, {OK}, lambda: library.SetFMUstate(handle, state))
        assert library.FreeFMUstate(handle, byref(state)) == OK

    def spoilt(self, data: bytes) -> tuple[str, bytes]:
        place = self.random.randrange(len(data))
        flipped = bytes([data[place] ^ self.random.randrange(1, 256)])
        return self.random.choice(
            [
                (f"cut at {place}", data[:place]),
                (f"byte {place} is {flipped!r}", data[:place] + flipped + data[place + 1 :]),
                (f"without byte {place}", data[:place] + data[place + 1 :]),
                ("noise", self.random.randbytes(self.random.randrange(200))),
            ]
        )

    # -- witnesses

    def check_witnesses(self) -> None:
        """The untouched instances have gone one step on to the bits of one alone; so does one that is reset."""
        for library, (handle, k) in self.witnesses.items():
            self.note(f"{self.made} {library.name}:witness step {k}")
            if k == 0:
                library.begin(handle)
            assert _one_step(library, handle, k) == self.alone[library][k], (
                f"{library.name}: others disturb an instance"
            )
            if k + 1 == ALONE:
                assert library.Reset(handle) == OK
            self.witnesses[library] = handle, (k + 1) % ALONE

    def check_reset(self) -> None:
        twin = self.pick()
        if not twin.alive:
            return
        self.call("Reset", "to compare", twin, {OK}, lambda: twin.library.Reset(twin.handle))
        rows = _run(twin.library, twin.handle, 5)
        assert rows == self.alone[twin.library][:5], f"{twin.library.name}: a reset instance is not as a fresh one"
        self.call("Reset", "after it", twin, {OK}, lambda: twin.library.Reset(twin.handle))
        twin.memory = reference.fresh(twin.library)

    # -- the walk

    def wander(self, calls: int) -> None:
        """Make about this many calls and look at the witnesses every hundred."""
        looked = self.made
        actions, weights = zip(*((getattr(self, name), weight) for name, weight in ACTIONS.items()), strict=True)
        while self.made < calls:
            self.random.choices(actions, weights)[0]()
            if self.made - looked >= 100:
                looked = self.made
                self.check_witnesses()


# The actions, and how often they are taken.
ACTIONS = {
    "instantiate_wrongly": 1,
    "free_instance": 2,
    "set_debug_logging": 2,
    "setup_experiment": 5,
    "enter_initialization_mode": 5,
    "exit_initialization_mode": 5,
    "lead": 5,
    "terminate": 2,
    "reset": 3,
    "get": 12,
    "set": 14,
    "observe": 8,
    "do_step": 14,
    "steps": 4,
    "ask_status": 3,
    "call_what_is_not_offered": 2,
    "get_state": 6,
    "set_state": 6,
    "free_state": 3,
    "serialize": 4,
    "deserialize": 5,
    "restore_own_bytes": 4,
    "check_reset": 0.3,
}


def _one_step(library: Library, handle: c_void_p, k: int) -> bytes:
    inputs, outputs = library.references("Real", "input"), library.references("Real", "output")
    assert library.set(handle, inputs, [0.1 * (i + 1) * (k % 5) for i in range(len(inputs))]) == OK
    assert library.step(handle, k * H, H) == OK
    return _bits(library.get(handle, outputs)[1])


def _run(library: Library, handle: c_void_p, steps: int) -> list[bytes]:
    library.begin(handle)
    return [_one_step(library, handle, k) for k in range(steps)]


@functools.cache
def _alone(library: Library) -> list[bytes]:
    handle = library.new("alone")
    rows = _run(library, handle, ALONE)
    library.FreeInstance(handle)
    return rows


def _bits(values) -> bytes:
    """Return the bits of numbers; of NaN always the same, as its sign means nothing and a state does not keep it."""
    return struct.pack(f"<{len(values)}d", *(value if value == value else math.nan for value in values))


def _same(a: float, b: float) -> bool:
    return a == b or (a != a and b != b)
