// Tokens that let a robot fetch its certificates, and the certificates that were issued.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ENROLMENT_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ENROLMENT_STORE_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips::store {

// Tokens kept; the oldest are forgotten, open ones last.
inline constexpr size_t kTokensMax = 10'000;
// Certificates of one identity that are good at a time: each is listed until it ends, so that an
// administrator who bans them misses none. One more is refused.
inline constexpr int64_t kGoodPerIdentityMax = 64;

// ResourceExhausted, for an identity with so many that are good.
inline absl::Status TooManyGood(absl::string_view uri, int64_t good) {
  return absl::ResourceExhaustedError(
      absl::StrCat(uri, " has ", good, " certificates that are good, the limit; see ",
                   "`ripsctl enrol list`: perhaps another has its key"));
}

struct TokenRecord {
  // 16 hex digits.
  std::string id;
  std::string robot;
  std::string host;
  // `sensor`, `actuator` or both, with a comma.
  std::string roles;
  // Who made it, as rpc::Describe gives it.
  std::string by;
  int64_t time_unix_ns = 0;
  int64_t expires_unix_ns = 0;
  bool revoked = false;

  friend bool operator==(const TokenRecord&, const TokenRecord&) = default;
};

struct IssuedRecord {
  // As rpc::ToString gives it.
  std::string uri;
  // Lower-case hex.
  std::string serial;
  // SHA-256 of the public key, lower-case hex.
  std::string key_hash;
  // Id of the token; empty = it was renewed.
  std::string token;
  int64_t time_unix_ns = 0;
  int64_t not_after_unix_ns = 0;
  // The certificate and those of the issuer; PEM. Empty in lists.
  std::string certificates_pem = {};

  friend bool operator==(const IssuedRecord&, const IssuedRecord&) = default;
};

// Durable when a method returns OK. Any thread; blocks on the disk. Errors as for Store.
class EnrolmentStore {
 public:
  virtual ~EnrolmentStore() = default;
  // AlreadyExists if there is one of that id.
  virtual absl::Status PutToken(const TokenRecord& token) = 0;
  // NotFound.
  virtual absl::StatusOr<TokenRecord> FindToken(absl::string_view id) = 0;
  // NotFound. Nothing happens to one that is revoked already.
  virtual absl::Status RevokeToken(absl::string_view id) = 0;
  // The newest first, kTokensMax at most.
  virtual absl::StatusOr<std::vector<TokenRecord>> ListTokens() = 0;
  // Of a token: FailedPrecondition if this identity's certificate was given to another key by it,
  // or it is revoked; AlreadyExists if it was given to this key; NotFound if the token is not kept.
  // ResourceExhausted if kGoodPerIdentityMax are good at the time of `issued`.
  virtual absl::Status PutIssued(const IssuedRecord& issued) = 0;
  // What a token gave this identity. NotFound.
  virtual absl::StatusOr<IssuedRecord> FindIssued(absl::string_view token,
                                                  absl::string_view uri) = 0;
  // Of this identity, of all if `uri` is empty; the newest first.
  virtual absl::StatusOr<std::vector<IssuedRecord>> ListIssued(absl::string_view uri) = 0;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ENROLMENT_STORE_H_
