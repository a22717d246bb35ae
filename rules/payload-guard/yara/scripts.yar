// Words that only a script says. A std_msgs/msg/String is its CDR header (4 bytes), the length of the
// text (4 bytes), then the text: it begins at byte 8.
//
// Fixed strings joined by conditions, no `.*`: a payload cannot make these slow.

rule interpreter_line
{
    meta:
        description = "the text begins with #!/"
    strings:
        $shebang = "#!/"
    condition:
        $shebang at 8 or
        // behind a byte order mark
        ($shebang at 11 and uint16(8) == 0xBBEF and uint8(10) == 0xBF)
}

rule download_and_run
{
    meta:
        description = "fetches something and hands it to a shell or an interpreter"
    strings:
        $curl = "curl "
        $wget = "wget "
        $to_sh = "| sh" fullword
        $to_sh_tight = "|sh" fullword
        $to_bash = "| bash" fullword
        $to_bash_tight = "|bash" fullword
        $to_python = "| python"
        $to_sudo = "| sudo "
        $and_run = "chmod +x"
        $and_run_octal = "chmod 777"
    condition:
        any of ($curl, $wget) and any of ($to_*, $and_*)
}

rule reverse_shell
{
    meta:
        description = "connects a shell to somebody else's machine"
    strings:
        $dev_tcp = "/dev/tcp/"
        $dev_udp = "/dev/udp/"
        $nc_run = "nc -e "
        $nc_run_too = "nc -c "
        $ncat_run = "--sh-exec"
        $fifo = "mkfifo /"
        $interactive = "sh -i"
        $dup2 = "os.dup2("
        $pty = "pty.spawn("
    condition:
        $dev_tcp or $dev_udp or any of ($nc*) or $pty or $dup2 or ($fifo and $interactive)
}

rule python_code
{
    meta:
        description = "Python that starts programs or runs text as code"
    strings:
        $system = "os.system("
        $popen = "subprocess.Popen("
        $run = "subprocess.run("
        $check = "subprocess.check_output("
        $import = "__import__("
        $exec64 = "exec(base64.b64decode("
        $eval64 = "eval(base64.b64decode("
        $marshal = "marshal.loads("
    condition:
        any of them
}

rule shell_code
{
    meta:
        description = "destroys or hides: what a shell script does that means harm"
    strings:
        $wipe = "rm -rf /"
        $wipe_preserve = "--no-preserve-root"
        $disk = "of=/dev/sd"
        $fork_bomb = ":(){ :|:& };:"
        $decode = "base64 -d"
        $to_sh = "| sh" fullword
        $to_sh_tight = "|sh" fullword
        $to_bash = "| bash" fullword
        $to_bash_tight = "|bash" fullword
        $passwords = "/etc/shadow"
        $keys = ".ssh/authorized_keys"
        $cron = "/etc/cron"
    condition:
        $wipe or $wipe_preserve or $disk or $fork_bomb or $passwords or $keys or $cron or
        ($decode and any of ($to_*))
}
