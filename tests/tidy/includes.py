"""Whether files name the headers of what they use, which precompiled headers would hide."""

import functools
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[2]

# A header, and the names of std:: or absl:: for which a file needs it. These are the headers of
# RipsTargets.cmake; names that many headers must declare (std::move, std::size_t) are not here.
HEADERS = {
    "algorithm": "std:: all_of any_of binary_search clamp copy copy_if count_if equal_range fill "
                 "find_if is_sorted lower_bound max_element min_element mismatch none_of "
                 "nth_element partition remove_if replace reverse rotate set_difference "
                 "set_intersection set_union shuffle sort stable_sort transform unique upper_bound",
    "atomic": "std:: atomic atomic_bool atomic_flag memory_order_relaxed",
    "cstdint": "std:: int8_t int16_t int32_t int64_t uint8_t uint16_t uint32_t uint64_t uintptr_t",
    "deque": "std:: deque",
    "filesystem": "std:: filesystem",
    "fstream": "std:: fstream ifstream ofstream",
    "functional": "std:: bind function greater hash invoke less",
    "map": "std:: map multimap",
    "memory": "std:: enable_shared_from_this make_shared make_unique shared_ptr unique_ptr "
              "weak_ptr",
    "optional": "std:: make_optional nullopt optional",
    "set": "std:: multiset set",
    "sstream": "std:: istringstream ostringstream stringstream",
    "string": "std:: getline stoi stol stoul stoull string to_string",
    "thread": "std:: this_thread thread",
    "variant": "std:: get_if holds_alternative monostate variant visit",
    "vector": "std:: vector",
    "absl/container/btree_map.h": "absl:: btree_map btree_multimap",
    "absl/container/flat_hash_map.h": "absl:: flat_hash_map",
    "absl/status/statusor.h": "absl:: StatusOr",
    "absl/strings/escaping.h": "absl:: Base64Escape Base64Unescape BytesToHexString CEscape "
                               "CHexEscape CUnescape HexStringToBytes Utf8SafeCEscape "
                               "Utf8SafeCHexEscape WebSafeBase64Escape WebSafeBase64Unescape",
    "absl/strings/match.h": "absl:: EndsWith EqualsIgnoreCase StartsWith StrContains",
    "absl/strings/numbers.h": "absl:: SimpleAtob SimpleAtod SimpleAtof SimpleAtoi SimpleHexAtoi",
    "absl/strings/str_cat.h": "absl:: Dec Hex StrAppend StrCat",
    "absl/strings/str_format.h": "absl:: FPrintF PrintF StrAppendFormat StrFormat",
    "absl/strings/str_join.h": "absl:: StrJoin",
    "absl/strings/str_replace.h": "absl:: StrReplaceAll",
    "absl/strings/str_split.h": "absl:: ByAnyChar MaxSplits SkipEmpty StrSplit",
    "absl/time/clock.h": "absl:: GetCurrentTimeNanos Now SleepFor",
    "absl/time/time.h": "absl:: Duration FormatDuration FormatTime InfiniteDuration InfiniteFuture "
                        "InfinitePast Microseconds Milliseconds Minutes Nanoseconds ParseDuration "
                        "ParseTime Seconds Time ToUnixNanos UnixEpoch ZeroDuration",
}
# Another header that declares the names of one.
ALSO = {
    "gtest/gtest.h": {"gmock/gmock.h"},
    "string": {"sstream", "fstream", "iostream"},
    "absl/time/time.h": {"absl/time/clock.h"},
}
HEADER_OF = {names.split()[0] + name: header for header, names in HEADERS.items()
             for name in names.split()[1:]}
INCLUDE = re.compile(r'^#include [<"]([^>"]+)[>"]', re.M)
NOT_CODE = re.compile(r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:[^"\\\n]|\\.)*"', re.S)
NAME = re.compile(r"\b(?:std|absl)::\w+|\b(?:EXPECT|ASSERT)_\w+(?=\()|\bTEST(?:_F|_P)?(?=\()|"
                  r"(?<![\w:])grpc::(?=\w)|\bv1::([A-Z]\w*)")


@functools.cache
def includes(file):
    """What a file of this tree includes, itself or by headers of this tree."""
    seen, waiting = set(), [file]
    while waiting:
        for header in INCLUDE.findall((ROOT / waiting.pop()).read_text(encoding="utf-8")):
            if header not in seen:
                seen.add(header)
                if (ROOT / header).is_file():
                    waiting.append(header)
    return seen


@functools.cache
def messages():
    """A message or enumeration of proto/ -> the header that is generated of it."""
    out = {}
    for path in (ROOT / "proto").rglob("*.proto"):
        for name in re.findall(r"^(?:message|enum) (\w+)", path.read_text(encoding="utf-8"), re.M):
            out[name] = str(path.relative_to(ROOT / "proto").with_suffix(".pb.h"))
    return out


def missing(file):
    """Pairs of a name that `file` uses, and the header of it that nothing there includes."""
    text = NOT_CODE.sub('""', (ROOT / file).read_text(encoding="utf-8"))
    there = includes(file)
    found = {}
    for match in NAME.finditer(text):
        name, message = match.group(0), match.group(1)
        if message:
            header = messages().get(message)
            if header and any(each.endswith(".pb.h") for each in there):
                continue  # generated headers include each other
        elif name == "grpc::":
            header = "grpcpp/grpcpp.h"
            if any(each.startswith("grpcpp/") or each.endswith(".grpc.pb.h") for each in there):
                continue
        elif "::" in name:
            header = HEADER_OF.get(name)
        else:
            header = "gtest/gtest.h"
        if header and header not in there and not ALSO.get(header, set()) & there:
            found.setdefault(header, name)
    return sorted((name, header) for header, name in found.items())
