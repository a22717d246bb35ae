// What a message takes in memory once it is parsed, told from its bytes before it is.
//
// An empty message in a list has two bytes on the wire and a hundred or two in memory, and so has
// each member of a oneof that the next one replaces: an arena keeps them all. The limits of fields
// (field_limits.h) are checked when it is too late for that.
#ifndef RIPS_SERVICES_WIRE_LIMITS_PARSED_SIZE_H_
#define RIPS_SERVICES_WIRE_LIMITS_PARSED_SIZE_H_

#include <cstddef>
#include <optional>

#include "google/protobuf/descriptor.h"
#include "google/protobuf/io/zero_copy_stream.h"
#include "services/wire_limits/field_limits.h"

namespace rips::wire_limits {

// A message may take so many times its bytes.
inline constexpr size_t kParsedPerByteMax = 256;
// So small that it cannot take too much: it is not looked at.
inline constexpr size_t kNotLookedAtBytes = kParsedBytesMax / kParsedPerByteMax;

// At least what the parser takes for `encoded`, a message of `type`; counts no further than just
// past kParsedBytesMax. What is malformed counts as far as it would be parsed; the parser may
// reserve memory for a text of which the end is missing, and does not touch it. Any thread.
size_t ParsedSize(const google::protobuf::Descriptor& type,
                  google::protobuf::io::ZeroCopyInputStream& encoded);

// kParsedSize if a message of `type`, which has `bytes` bytes in `encoded`, would take more than
// kParsedBytesMax.
std::optional<LimitHit> CheckParsedSize(const google::protobuf::Descriptor& type, size_t bytes,
                                        google::protobuf::io::ZeroCopyInputStream& encoded);

}  // namespace rips::wire_limits

#endif  // RIPS_SERVICES_WIRE_LIMITS_PARSED_SIZE_H_
