set -e

# What each package sets (deploy/debian/PACKAGE.sh), one item a line:
directories=""  # PATH OWNER GROUP MODE: made at the first installation, removed by a purge
daemons=""      # UNIT PROGRAM USER CONFIGURATION: restarted by an upgrade; PROGRAM `-`: unchecked
triggers=""     # UNIT: sockets and timers
on_configure() { :; }  # further steps of the package; $1 is the version that was there, or empty

has_systemd() { [ -d /run/systemd/system ]; }

services() { echo "$daemons" | while read -r unit rest; do echo "$unit"; done; }

make_directories() {  # the version that was there, or empty
  echo "$directories" | while read -r path owner group mode; do
    [ -n "$path" ] || continue
    # What was there before an upgrade is as the administrator wants it.
    if [ -L "$path" ] || { [ -n "$1" ] && [ -d "$path" ]; }; then continue; fi
    if [ -e "$path" ] && [ ! -d "$path" ]; then
      echo "$DPKG_MAINTSCRIPT_PACKAGE: $path is no directory; move it away and install again" >&2
      exit 1
    fi
    install -d -o "$owner" -g "$group" -m "$mode" "$path"
  done
}

# A running daemon goes on as the old version if the new one refuses the configuration.
restart_daemons() {
  echo "$daemons" | while read -r unit program user configuration; do
    if [ -z "$unit" ] || ! systemctl --quiet is-active "$unit"; then continue; fi
    if [ "$program" != - ] && ! reason=$(timeout 60 setpriv --reuid="$user" --regid="$user" \
        --init-groups "$program" --config "$configuration" --check-config \
        2>&1 >/dev/null </dev/null); then
      cat >&2 <<END
*** $unit is NOT restarted: the new version refuses $configuration:
$reason
*** The old process goes on, but cannot be started again. Mend the file before the next boot, try
*** it with \`$program --check-config\`, then run \`systemctl restart $unit\`.
END
      continue
    fi
    deb-systemd-invoke restart "$unit" >/dev/null </dev/null || true
  done
}
