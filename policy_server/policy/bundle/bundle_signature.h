// Signatures of bundles: who answers for what judges a robot. A bundle's signature is the file
// kSignatureName in its directory, one line:
//   ed25519 KEYID BASE64\n
// KEYID is the first 16 hex digits of the SHA-256 of the raw public key. BASE64 (RFC 4648, padded)
// is the Ed25519 signature (RFC 8032) of "rips-bundle-signature 1\n" and the bundle's id. The
// signature is no part of the id: a bundle may be signed later, or anew.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_SIGNATURE_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_SIGNATURE_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::bundle {

inline constexpr char kSignatureName[] = "signature";
// What stands beside it for a moment while it is replaced.
inline constexpr char kSignatureTemporaryName[] = "signature.tmp";
// More than any has.
inline constexpr size_t kSignatureBytesMax = 1024;
// Of a file with a key in PEM.
inline constexpr size_t kKeyFileBytesMax = 16 << 10;

// The text of kSignatureName for the bundle `id` (as Bundle::id). InvalidArgument: not one private
// Ed25519 key in PEM, or it is encrypted; the message begins with "the private key". Never has
// anything of the key.
absl::StatusOr<std::string> SignBundle(absl::string_view id, absl::string_view private_key_pem);

// The text of `dir`/signature, unchecked; empty if there is no such file. Other errors as
// BundleDirectory::Read; NotFound only for `dir`.
absl::StatusOr<std::string> ReadSignature(const std::string& dir);

// The public keys that a server trusts. Immutable once loaded; any thread.
class SignerKeys {
 public:
  // None: verifies nothing.
  SignerKeys() = default;
  // Files of one public Ed25519 key in PEM each. A key is named as its file without `.pem`; names
  // and keys are distinct. Errors name the file: those of ReadFile, and InvalidArgument.
  static absl::StatusOr<SignerKeys> Load(const std::vector<std::string>& paths);

  bool empty() const { return keys_.empty(); }
  // The name of the key that signed the bundle `id`; `signature` as ReadSignature gives it.
  // PermissionDenied: there is no signature, it is malformed, of a key that is not among these, or
  // not of this bundle. Says which, and how to sign.
  absl::StatusOr<std::string> Verify(absl::string_view id, absl::string_view signature) const;

 private:
  struct Key {
    std::string name;
    // 32 bytes.
    std::string public_key;
  };

  absl::Status Add(const std::string& path);

  // By key id.
  absl::btree_map<std::string, Key> keys_;
};

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_SIGNATURE_H_
