# The latter as the unit's StateDirectory= would make it.
directories="/etc/rips/pki/actuator root rips 0750
/var/lib/rips/actuator rips rips 0700"
# The actuator last: it finds its helpers renewed.
daemons="rips-exec.service /usr/bin/rips-exec rips-exec /etc/rips/actuator.yaml
rips-fw.service /usr/bin/rips-fw rips-fw /etc/rips/actuator.yaml
rips-actuator.service /usr/bin/rips-actuator rips /etc/rips/actuator.yaml"
triggers="rips-exec.socket rips-fw.socket"
on_configure() {
  # Alarms that are plugged in already get the group of the rules.
  if [ -z "$1" ] && [ -S /run/udev/control ]; then
    udevadm control --reload || true
    udevadm trigger --action=change --subsystem-match=hidraw --subsystem-match=tty || true
  fi
}
