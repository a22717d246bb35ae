// Programs for a machine, anywhere in a message: for Linux and Windows, as they are or in base64, and
// Python objects that run something when they are read.
// Every string is at least five fixed bytes long, so that a scan is one pass over the message.

rule elf_file
{
    meta:
        description = "ELF: program or shared library for Linux"
    strings:
        // \x7fELF, class, byte order, version 1.
        $le32 = { 7F 45 4C 46 01 01 01 }
        $be32 = { 7F 45 4C 46 01 02 01 }
        $le64 = { 7F 45 4C 46 02 01 01 }
        $be64 = { 7F 45 4C 46 02 02 01 }
    condition:
        any of them
}

rule elf_file_base64
{
    meta:
        description = "ELF at the beginning of a base64 text"
    strings:
        $le32 = "f0VMRgEBA"
        $be32 = "f0VMRgECA"
        $le64 = "f0VMRgIBA"
        $be64 = "f0VMRgICA"
    condition:
        any of them
}

rule windows_program
{
    meta:
        description = "PE: the text of the DOS stub that every linker leaves"
    strings:
        $stub = "This program cannot be run in DOS mode"
        $stub_base64 = "This program cannot be run in DOS mode" base64
    condition:
        any of them
}

rule pickled_call
{
    meta:
        description = "Python pickle that calls a function of the system when it is loaded"
    strings:
        $posix_text = "cposix\nsystem\n"
        $os_text = "cos\nsystem\n"
        $subprocess_text = "csubprocess\n"
        $builtin_text = "c__builtin__\neval\n"
        // SHORT_BINUNICODE module, MEMOIZE, SHORT_BINUNICODE function: protocol 4.
        $posix_binary = { 8C 05 70 6F 73 69 78 94 8C 06 73 79 73 74 65 6D }
        $eval_binary = { 8C 08 62 75 69 6C 74 69 6E 73 94 8C 04 65 76 61 6C }
        $exec_binary = { 8C 08 62 75 69 6C 74 69 6E 73 94 8C 04 65 78 65 63 }
    condition:
        any of them
}
