# The latter as the unit's StateDirectory= would make it.
directories="/etc/rips/pki/sensor root rips-sensor 0750
/var/lib/rips/sensor rips-sensor rips-sensor 0700"
# The tap has no configuration but the flags in its unit.
daemons="rips-sensor.service /usr/bin/rips-sensor rips-sensor /etc/rips/sensor.yaml
rips-wire.service - - -"
