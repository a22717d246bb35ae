#include "services/rpc/revocation.h"

#include <dirent.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509v3.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/rpc/openssl_types.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::rpc {
namespace {

using openssl::Bio;
using openssl::Certificate;
using openssl::Crl;

constexpr size_t kCrlBytesMax = 16 << 20;
constexpr size_t kCrlFilesMax = 256;

// Every list in `pem`, certificates skipped. InvalidArgument if one cannot be decoded.
absl::Status ReadLists(absl::string_view pem, std::vector<Crl>* lists) {
  const Bio bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  char* name = nullptr;
  char* header = nullptr;
  unsigned char* data = nullptr;
  long size = 0;  // NOLINT: as OpenSSL declares it
  absl::Status status;
  while (status.ok() && PEM_read_bio(bio.get(), &name, &header, &data, &size) == 1) {
    if (absl::string_view(name) == PEM_STRING_X509_CRL) {
      const unsigned char* at = data;
      Crl list(d2i_X509_CRL(nullptr, &at, size));
      if (list == nullptr) {
        status = absl::InvalidArgumentError("it holds a revocation list that cannot be decoded");
      } else {
        lists->push_back(std::move(list));
      }
    }
    OPENSSL_free(name);
    OPENSSL_free(header);
    OPENSSL_free(data);
  }
  const bool ended = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  ERR_clear_error();
  if (status.ok() && !ended) return absl::InvalidArgumentError("it is not whole PEM");
  return status;
}

// `authority` chains to one of `roots`, through `others`; its times do not matter: what it took
// back stays taken back.
bool IsTrusted(X509* authority, const std::vector<Certificate>& roots,
               const std::vector<Certificate>& others) {
  const openssl::Store store(X509_STORE_new());
  for (const Certificate& root : roots) X509_STORE_add_cert(store.get(), root.get());
  X509_STORE_set_flags(store.get(), X509_V_FLAG_NO_CHECK_TIME);
  const std::unique_ptr<STACK_OF(X509), openssl::FreeStack> untrusted(sk_X509_new_null());
  for (const Certificate& each : others) sk_X509_push(untrusted.get(), each.get());
  const openssl::StoreContext context(X509_STORE_CTX_new());
  const bool trusted =
      X509_STORE_CTX_init(context.get(), store.get(), authority, untrusted.get()) == 1 &&
      X509_verify_cert(context.get()) == 1;
  ERR_clear_error();
  return trusted;
}

// An authority that may sign lists (RFC 5280 §4.2.1.3) has signed this one.
bool IsSigned(X509_CRL* list, const std::vector<Certificate>& roots,
              const std::vector<Certificate>& others) {
  const auto signs = [&](const Certificate& each) {
    if (X509_NAME_cmp(X509_get_subject_name(each.get()), X509_CRL_get_issuer(list)) != 0 ||
        X509_check_ca(each.get()) == 0 || (X509_get_key_usage(each.get()) & KU_CRL_SIGN) == 0) {
      return false;
    }
    const bool good = X509_CRL_verify(list, X509_get0_pubkey(each.get())) == 1;
    ERR_clear_error();
    return good && IsTrusted(each.get(), roots, others);
  };
  return std::any_of(roots.begin(), roots.end(), signs) ||
         std::any_of(others.begin(), others.end(), signs);
}

// The files that hold lists: `path`, or those in it if it is a directory, sorted.
absl::StatusOr<std::vector<std::string>> ListFiles(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read `", path, "`"));
  }
  if (!S_ISDIR(info.st_mode)) return std::vector<std::string>{path};
  DIR* dir = opendir(path.c_str());
  if (dir == nullptr) return absl::ErrnoToStatus(errno, absl::StrCat("cannot read `", path, "`"));
  std::vector<std::string> files;
  while (const dirent* entry = readdir(dir)) {
    const absl::string_view name = entry->d_name;
    if (absl::EndsWith(name, ".pem") || absl::EndsWith(name, ".crl")) {
      files.push_back(absl::StrCat(path, "/", name));
    }
  }
  closedir(dir);
  if (files.size() > kCrlFilesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("`", path, "` holds ", files.size(), " files, limit ", kCrlFilesMax));
  }
  std::sort(files.begin(), files.end());
  return files;
}

// Changes when a file does. What cannot be read has a stamp, too.
std::string Stamp(const std::string& path) {
  const absl::StatusOr<std::vector<std::string>> files = ListFiles(path);
  if (!files.ok()) return std::string(files.status().message());
  std::string stamp;
  for (const std::string& file : *files) {
    struct stat info = {};
    const int result = stat(file.c_str(), &info);
    absl::StrAppend(&stamp, file, " ", result, " ", info.st_ino, " ", info.st_size, " ",
                    info.st_mode, " ", info.st_ctim.tv_sec, ".", info.st_ctim.tv_nsec, "\n");
  }
  return stamp;
}

}  // namespace

absl::StatusOr<RevocationLists> RevocationLists::Parse(const std::vector<std::string>& pems,
                                                       absl::string_view ca,
                                                       absl::string_view authorities) {
  const std::vector<Certificate> roots = openssl::ReadCertificates(ca);
  std::vector<Certificate> others = openssl::ReadCertificates(authorities);
  std::vector<Crl> lists;
  for (const std::string& pem : pems) {
    RIPS_RETURN_IF_ERROR(ReadLists(pem, &lists));
    for (Certificate& each : openssl::ReadCertificates(pem)) others.push_back(std::move(each));
  }
  if (lists.empty()) return absl::InvalidArgumentError("there is no revocation list in it");
  RevocationLists parsed;
  for (const Crl& list : lists) {
    if (!IsSigned(list.get(), roots, others)) {
      return absl::InvalidArgumentError(
          "it holds a revocation list that no authority under `ca` signed; if an issuing authority "
          "did, put its certificate beside the list");
    }
    RIPS_ASSIGN_OR_RETURN(const absl::Time this_update,
                          openssl::ToTime(X509_CRL_get0_lastUpdate(list.get())));
    absl::Time next = absl::InfiniteFuture();
    if (const ASN1_TIME* time = X509_CRL_get0_nextUpdate(list.get())) {
      RIPS_ASSIGN_OR_RETURN(next, openssl::ToTime(time));
    }
    const std::string issuer = openssl::NameText(X509_CRL_get_issuer(list.get()));
    const auto [at, fresh] = parsed.by_issuer_.try_emplace(issuer);
    if (!fresh && at->second.this_update > this_update) continue;
    // Two of the same second: what either takes back.
    if (fresh || at->second.this_update < this_update) {
      at->second = {.this_update = this_update, .next_update = next, .serials = {}};
    }
    const STACK_OF(X509_REVOKED)* revoked = X509_CRL_get_REVOKED(list.get());
    for (int i = 0; i < sk_X509_REVOKED_num(revoked); ++i) {
      at->second.serials.insert(
          openssl::SerialText(X509_REVOKED_get0_serialNumber(sk_X509_REVOKED_value(revoked, i))));
    }
  }
  for (const auto& [issuer, list] : parsed.by_issuer_) {
    parsed.next_update_ = std::min(parsed.next_update_, list.next_update);
  }
  return parsed;
}

bool RevocationLists::Revokes(const CertificateId& certificate) const {
  const auto at = by_issuer_.find(certificate.issuer);
  return at != by_issuer_.end() && at->second.serials.contains(certificate.serial);
}

absl::Status RevocationLists::Follows(const RevocationLists& old) const {
  for (const auto& [issuer, list] : old.by_issuer_) {
    const auto at = by_issuer_.find(issuer);
    if (at == by_issuer_.end()) {
      return absl::FailedPreconditionError("the list of an authority is gone");
    }
    if (at->second.this_update < list.this_update) {
      return absl::FailedPreconditionError(
          absl::StrCat("a list of ", absl::FormatTime(at->second.this_update, absl::UTCTimeZone()),
                       " is older than the one in force, of ",
                       absl::FormatTime(list.this_update, absl::UTCTimeZone())));
    }
  }
  return absl::OkStatus();
}

size_t RevocationLists::size() const {
  size_t count = 0;
  for (const auto& [issuer, list] : by_issuer_) count += list.serials.size();
  return count;
}

absl::StatusOr<std::shared_ptr<Revocations>> Revocations::Open(const TlsFiles& files) {
  std::shared_ptr<Revocations> opened(new Revocations(files));
  const std::string stamp = Stamp(files.crl);
  RIPS_ASSIGN_OR_RETURN(RevocationLists lists, opened->Read());
  MutexLock lock(&opened->mu_);
  opened->lists_ = std::make_shared<const RevocationLists>(std::move(lists));
  opened->stamp_ = stamp;
  return opened;
}

absl::StatusOr<RevocationLists> Revocations::Read() const {
  RIPS_ASSIGN_OR_RETURN(const std::string ca, ReadFile(files_.ca, kCrlBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::string authorities, ReadFile(files_.cert, kCrlBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFiles(files_.crl));
  std::vector<std::string> pems;
  for (const std::string& name : names) {
    RIPS_ASSIGN_OR_RETURN(std::string pem, ReadFile(name, kCrlBytesMax));
    pems.push_back(std::move(pem));
  }
  absl::StatusOr<RevocationLists> lists = RevocationLists::Parse(pems, ca, authorities);
  if (lists.ok()) return lists;
  return absl::Status(lists.status().code(),
                      absl::StrCat("revocation list `", files_.crl,
                                   "` cannot be used: ", lists.status().message()));
}

void Revocations::Refresh() {
  const std::string stamp = Stamp(files_.crl);
  {
    MutexLock lock(&mu_);
    if (stamp == stamp_ && unread_.ok()) return;
  }
  absl::StatusOr<RevocationLists> lists = Read();
  MutexLock lock(&mu_);
  stamp_ = stamp;
  absl::Status status = lists.status();
  if (status.ok()) status = lists->Follows(*lists_);
  const bool news = unread_ != status;
  unread_ = status;
  if (!status.ok()) {
    if (!news) return;
    LogError("revocation list rejected; keeping the previous one",
             {{"file", files_.crl}, {"reason", status.message()}});
    return;
  }
  lists_ = std::make_shared<const RevocationLists>(*std::move(lists));
  LogInfo("revocation list in force", {{"file", files_.crl}, {"revoked", lists_->size()}});
}

bool Revocations::Revoke(const std::vector<CertificateId>& chain) const {
  MutexLock lock(&mu_);
  return std::any_of(chain.begin(), chain.end(),
                     [&lists = *lists_](const CertificateId& each) { return lists.Revokes(each); });
}

absl::Status Revocations::problem(absl::Time now) const {
  MutexLock lock(&mu_);
  if (!unread_.ok()) return unread_;
  if (now <= lists_->next_update()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      "the revocation list `", files_.crl, "` should have been replaced before ",
      absl::FormatTime(lists_->next_update(), absl::UTCTimeZone()), "; it stays in force"));
}

}  // namespace rips::rpc
