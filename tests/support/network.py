"""Hosts on this machine: network namespaces on a bridge that is in a namespace, too. No interface
of the machine is among them, so that nothing leaves them and nothing comes in."""

import os
import shutil
import signal
import subprocess

from fleet import Failed, Skipped

LIMIT = 90  # seconds one command may take on a busy machine
PATH = "/usr/sbin:/usr/bin:/sbin:/bin"


def run(*args, ok=True):
    done = subprocess.run([str(arg) for arg in args], capture_output=True, text=True, timeout=LIMIT)
    if ok and done.returncode != 0:
        raise Failed(f"{' '.join(map(str, args))}: {done.stderr.strip()}")
    return done


class Network:
    """`hosts`, name to IPv4 address, all in one /24; the interface of each is eth0. `tag` begins
    the names of the namespaces, and must be of this run alone."""

    def __init__(self, tag, hosts):
        self.tag = tag
        self.hosts = hosts
        self.made = []

    def ns(self, host):
        return f"{self.tag}-{host}"

    def within(self, host):
        """What a command begins with that is to run on `host`."""
        return ["ip", "netns", "exec", self.ns(host)]

    def build(self):
        switch = self.add("switch")
        run("ip", "-n", switch, "link", "add", "br0", "type", "bridge", "mcast_snooping", "0")
        run("ip", "-n", switch, "link", "set", "br0", "up")
        for host, address in self.hosts.items():
            namespace = self.add(host)
            run("ip", "-n", switch, "link", "add", host, "type", "veth", "peer", "name", "eth0",
                "netns", namespace)
            run("ip", "-n", switch, "link", "set", host, "master", "br0", "up")
            run("ip", "-n", namespace, "link", "set", "lo", "up")
            run("ip", "-n", namespace, "link", "set", "eth0", "up")
            run("ip", "-n", namespace, "address", "add", f"{address}/24", "dev", "eth0")

    def remove(self):
        """All that build() has made, also after it failed, and what still runs there."""
        for namespace in self.made:
            for pid in run("ip", "netns", "pids", namespace, ok=False).stdout.split():
                try:
                    os.kill(int(pid), signal.SIGKILL)
                except ProcessLookupError:
                    pass  # it has ended meanwhile
        while self.made:
            run("ip", "netns", "delete", self.made.pop(), ok=False)

    def left(self):
        """The namespaces of this run that are there."""
        names = [line.split()[0] for line in run("ip", "netns", "list").stdout.splitlines()]
        return [name for name in names if name.startswith(f"{self.tag}-")]

    def add(self, host):
        self.made.append(self.ns(host))  # before it is there: a signal may come between
        run("ip", "netns", "add", self.ns(host))
        return self.ns(host)


def _try(hosts, attempt):
    """Why an attempt with a network of these hosts fails, in one line; None if it does not."""
    trial = Network(f"ripstrial{os.getpid()}", hosts)
    try:
        attempt(trial)
    except Failed as failed:
        return f"network namespaces are not allowed here: {' '.join(str(failed).split())}"
    finally:
        trial.remove()
    return None


def _absent(tools):
    for tool in tools:
        if shutil.which(tool, path=PATH) is None:
            return f"the program `{tool}` is not installed"
    return None if os.geteuid() == 0 else "network namespaces need root"


def missing():
    """What this machine or this user lacks for a network of hosts with packet filters, in one line;
    None if nothing."""
    def attempt(trial):
        trial.build()
        run(*trial.within("host"), "nft", "list", "ruleset")

    return _absent(("ip", "nft")) or _try({"host": "10.77.0.1"}, attempt)


def need_namespaces():
    """Raises Skipped where no program can be started in a network namespace with an interface."""
    def attempt(trial):
        namespace = trial.add("host")
        run("ip", "-n", namespace, "link", "add", "eth0", "type", "veth", "peer", "name", "eth1")
        run(*trial.within("host"), "true")

    lacks = _absent(["ip"]) or _try({}, attempt)
    if lacks is not None:
        raise Skipped(lacks)
