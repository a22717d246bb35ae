// An enrolment token as the line of text that an administrator carries to a robot.
#ifndef RIPS_SERVICES_ENROL_TOKEN_TEXT_H_
#define RIPS_SERVICES_ENROL_TOKEN_TEXT_H_

#include <cstddef>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "rips/v1/enrolment.pb.h"

namespace rips::enrol {

inline constexpr size_t kTokenBytesMax = 64 << 10;
inline constexpr absl::string_view kTokenPrefix = "rips-token-1.";

// One line, without the newline.
std::string FormatToken(const v1::EnrolmentToken& token);

// White space around it, and line breaks that a mail or a terminal has put into it, do not count.
// InvalidArgument, without a piece of the secret, for what is none: cut, altered, of another
// version, or with names, roles or an address that cannot be.
absl::StatusOr<v1::EnrolmentToken> ParseToken(absl::string_view text);

}  // namespace rips::enrol

#endif  // RIPS_SERVICES_ENROL_TOKEN_TEXT_H_
