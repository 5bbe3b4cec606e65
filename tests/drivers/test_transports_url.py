"""Bus URLs: what opens what, and every wrong one answered with what would be right."""

import subprocess
import sys

import pytest

from drivers.errors import DriverError, UrlError
from drivers.transports import open_can, open_i2c, open_pair, open_pulse, open_pulse_output, open_serial


def clock():
    return 0


@pytest.mark.parametrize(
    ("opener", "url", "remedy"),
    [
        (open_i2c, "spi:///dev/spidev0.0", "begin it with any of i2c, i2c\\+unix"),
        (open_i2c, "/dev/i2c-1", "begin it with"),
        (open_i2c, "i2c://dev/i2c-1", "before the path: write i2c:///dev"),
        (open_i2c, "i2c://", "with three slashes"),
        (open_i2c, "i2c:///dev/i2c-1?speed=400000", "unknown options speed: it takes none"),
        (open_i2c, "i2c+unix:///x?timeout_s=soon", "timeout_s=soon is not a number"),
        (open_can, "can+usb://can0", "can\\+socketcan, can\\+virtual, can\\+slcan"),
        (open_can, "can+socketcan:///can0", "needs a name and no path"),
        (open_can, "can+socketcan://", "needs a name"),
        (open_can, "can+socketcan://can0?bitrate=fast", "bitrate=fast is not a whole number"),
        (open_can, "can+socketcan://can0?bit_rate=5", "use only bitrate, receive_buffer"),
        (open_can, "can+virtual://x?timestamps=sundial", "use any of monotonic, realtime"),
        (open_can, "can+slcan:///dev/ttyS0", "lacks bitrate: add '\\?bitrate="),
        (open_can, "can+slcan:///dev/ttyS0?bitrate=333333", "use any of 10000, 20000"),
        (open_pulse, "gpio:///dev/gpiochip0", "lacks line"),
        (open_pulse, "pulse:///dev/pps0", "gpio, pps, gpio\\+unix"),
        (open_pulse, "pps:///dev/pps0?line=1", "unknown options line: it takes none"),
        (open_pulse_output, "gpio:///dev/gpiochip0?line=27", "begin it with any of gpio-out"),
        (open_pulse_output, "gpio-out:///dev/gpiochip0", "lacks line"),
        (open_pair, "gpio-pair:///dev/gpiochip0?data=5", "lacks clock: add '\\?clock="),
        (open_pair, "gpio-pair:///dev/gpiochip0?data=5&clock=5", "the same line for both: correct data or clock"),
        (open_pair, "gpio:///dev/gpiochip0?line=5", "begin it with any of gpio-pair, gpio-pair\\+unix"),
        (open_serial, "serial:///dev/ttyUSB0", "lacks baud"),
        (
            open_serial,
            "serial:///dev/ttyUSB0?baud=9600&parity=X",
            "parity=X is none that it can have: use any of N, E, O",
        ),
        (open_serial, "serial:///dev/ttyUSB0?baud=9600&stop_bits=3", "stop_bits=3 is none .* use any of 1, 2"),
        (open_i2c, "i2c:///dev/i2c-1#2", "has a '#'"),
        (open_can, "can+socketcan://can0?bitrate=-1", "bitrate=-1 is not a whole number"),
        (open_can, "can+socketcan://can0?bitrate=1000001", "is not within 1 and 1000000"),
        (open_can, "can+socketcan://can0?bitrate=500_000", "is not a whole number"),
        (open_can, "can+socketcan://can0?receive_buffer=4294967296", "is not within 1 and 2147483647"),
        (open_can, "can+python:///pcan?bitrate=500000", "needs an interface and a channel"),
        (open_pulse, "gpio:///dev/gpiochip0?line=-17", "line=-17 is not a whole number"),
        (open_pulse, "gpio:///dev/gpiochip0?line=0x11", "is not a whole number"),
        (open_serial, "serial:///dev/ttyUSB0?baud=9600&baud=19200", "gives an option twice"),
        (open_serial, "serial:///dev/ttyUSB0?baud", "baud= is not a whole number"),
        (open_serial, "serial:///dev/ttyUSB0?baud=9600&timeout_s=nan", "timeout_s=nan is not a number"),
        (open_serial, "serial:///dev/null?baud=-5", "baud=-5 is not a whole number"),
    ],
)
def test_a_wrong_url_is_answered_with_the_right_one(opener, url, remedy):
    with pytest.raises(UrlError, match=remedy) as caught:
        opener(url) if opener is open_serial else opener(url, clock)
    assert url in str(caught.value)
    assert isinstance(caught.value, DriverError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("url", ["i2c:///dev/i2c\0", "i2c:///dev/i2c\n-1", f"i2c:///dev/{'i' * 5000}", "i2c:///\ud800"])
def test_a_url_that_no_system_call_takes_is_refused(url):
    with pytest.raises(UrlError, match="cannot be printed, or more than 4096") as caught:
        open_i2c(url, clock)
    assert len(str(caught.value)) < 400


def test_many_options_are_refused_with_a_short_message():
    with pytest.raises(UrlError, match="none: Max number of fields") as caught:
        open_serial("serial:///dev/tty?" + "&".join(f"a{n}=1" for n in range(500)))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("opener", "url"),
    [
        (open_i2c, "i2c:///dev/no-such-i2c"),
        (open_can, "can+socketcan://no_such_can?bitrate=500000"),
        (open_can, "can+slcan:///dev/no-such-tty?bitrate=500000"),
        (open_pulse, "gpio:///dev/no-such-gpiochip?line=3"),
        (open_pulse, "pps:///dev/no-such-pps"),
        (open_pulse, "gpio+unix:///no-such-folder/edges"),
        (open_pulse_output, "gpio-out:///dev/no-such-gpiochip?line=3"),
        (open_pair, "gpio-pair:///dev/no-such-gpiochip?data=3&clock=4"),
        (open_serial, "serial:///dev/no-such-tty?baud=9600"),
    ],
)
def test_what_is_not_there_is_an_os_error(opener, url):
    with pytest.raises(OSError, match=r".") as caught:
        opener(url) if opener is open_serial else opener(url, clock)
    assert not isinstance(caught.value, UrlError)


def test_importing_drivers_loads_no_bus_library():
    program = (
        "import sys, drivers, drivers.transports, drivers.mpu6050, drivers.canopen_pdo, drivers.sync_pulse\n"
        "sys.exit(str({'smbus2', 'can', 'serial', 'gpiod', 'canopen'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert run.stderr.strip() == "set()"
