"""PyTrinamic drives the emulated TMCL module on the serial port argv[1]; says what it found as TOML."""

import json
import sys

from pytrinamic.connections import SerialTmclInterface
from pytrinamic.evalboards import TMC6140_eval
from pytrinamic.tmcl import TMCLCommand, TMCLReplyStatusError

said = {}
with SerialTmclInterface(sys.argv[1], datarate=115200, timeout_s=10) as interface:
    said["version_text"] = interface.get_version_string()
    said["version"] = interface.send(TMCLCommand.GET_FIRMWARE_VERSION, 1, 0, 0).value
    motor = TMC6140_eval(interface).motors[0]
    parameters = motor.AP

    said["round_trips"] = []
    for units in [0, 1, -1, 16384, -16384, 32767, -32767] + [(n * 7919) % 65535 - 32767 for n in range(200)]:
        motor.set_target_pwm(units)
        said["round_trips"].append([units, motor.get_axis_parameter(parameters.TargetPWM, signed=True)])

    said["current"] = motor.get_axis_parameter(parameters.Current, signed=True)
    said["velocity"] = motor.get_axis_parameter(parameters.ActualHallVelocity, signed=True)
    said["pwm"] = motor.get_axis_parameter(parameters.ActualPWM, signed=True)
    said["errors"] = motor.get_axis_parameter(9, signed=True)
    said["supply"] = interface.get_analog_input(5)

    refused = {}
    for what, call in {
        "too much": lambda: motor.set_target_pwm(40000),
        "read only": lambda: motor.set_axis_parameter(parameters.ActualHallVelocity, 5),
        "no such parameter": lambda: motor.get_axis_parameter(200),
        "no such axis": lambda: interface.get_axis_parameter(parameters.TargetPWM, 3),
        "no such instruction": lambda: interface.send(TMCLCommand.RFS, 0, 0, 0),
    }.items():
        try:
            call()
            refused[what] = 0
        except TMCLReplyStatusError as error:
            refused[what] = error.status_code

    motor.set_target_pwm(-8192)
    said["before_stop"] = motor.get_axis_parameter(parameters.TargetPWM, signed=True)
    TMC6140_eval(interface).stop(0)
    said["after_stop"] = motor.get_axis_parameter(parameters.TargetPWM, signed=True)
    motor.set_target_pwm(8192)

# Numbers, strings and lists are written alike in JSON and TOML.
for key, value in said.items():
    print(f"{key} = {json.dumps(value)}")
print("[refused]")
for key, value in refused.items():
    print(f"{json.dumps(key)} = {value}")
