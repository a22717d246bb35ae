// What tests/bench/run scans payloads with. None matches its payloads.
rule mark { strings: $a = "RIPS-BENCH-MARK" condition: $a }
rule shell { strings: $a = "/bin/sh -c" $b = "bash -i >&" $c = "nc -e /bin" condition: any of them }
rule fetch { strings: $a = "wget http://" nocase $b = "curl -s http://" nocase condition: any of them }
rule elf { strings: $a = { 7F 45 4C 46 02 01 01 00 00 00 00 00 } condition: $a }
rule pe { strings: $a = { 4D 5A 90 00 03 00 00 00 } $b = "This program cannot be run" wide ascii condition: all of them }
rule script { strings: $a = "<script>document." nocase $b = "eval(unescape(" nocase condition: any of them }
rule key { strings: $a = "-----BEGIN RSA PRIVATE KEY-----" $b = "-----BEGIN OPENSSH PRIVATE" condition: any of them }
rule sled { strings: $a = { 90 90 90 90 90 90 90 90 90 90 90 90 } condition: $a }
rule calls { strings: $a = { E8 ?? ?? ?? ?? 5B 81 EB [4-8] CD 80 } condition: $a }
rule jump { strings: $a = { EB FE 48 31 [2-6] 0F 05 } condition: $a }
rule traversal { strings: $a = "../../../../etc/passwd" $b = "..\\..\\..\\windows" nocase condition: any of them }
rule sql { strings: $a = "' OR '1'='1" nocase $b = "UNION SELECT ALL" nocase condition: any of them }
rule python { strings: $a = "__import__('os').system" $b = "subprocess.Popen(" condition: any of them }
rule pickle { strings: $a = { 80 04 95 [8] 8C 05 70 6F 73 69 78 } condition: $a }
rule url { strings: $a = /https?:\/\/[a-z0-9]{8,32}\.onion\// condition: $a }
rule address { strings: $a = /gateway=169\.254\.[0-9]{1,3}\.[0-9]{1,3}/ condition: $a }
rule domain { strings: $a = "ROS_DOMAIN_ID=" wide ascii $b = "rmw_implementation=" nocase condition: all of them }
rule frame { strings: $a = "map_hijack" $b = "odom_override" condition: any of them }
rule texture { strings: $a = { DE AD BE EF [0-16] CA FE BA BE } condition: $a }
rule large { strings: $a = "GIF89a-not-an-image" condition: $a and filesize > 1KB }
