# The checks of serial.sh behind `ftdi_sio`.
# checks: 16
port=/dev/ttyUSB0 plug_in=ftdi serial=STAGE0002
. /vm/serial.sh
