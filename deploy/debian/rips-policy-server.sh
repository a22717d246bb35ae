# The latter two as the unit's StateDirectory= and LogsDirectory= would make them at its first
# start: `--check-config` wants them before.
directories="/etc/rips/pki/policy-server root rips-policy-server 0750
/var/lib/rips/policy-server rips-policy-server rips-policy-server 0700
/var/log/rips rips-policy-server rips-policy-server 0750"
server=rips-policy-server
daemons="$server.service /usr/bin/$server $server /etc/rips/policy-server.yaml"
